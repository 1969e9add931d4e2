//! A pair or a sweep of a batch: read, solved, written.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use parfocal::export::is_whole;
use parfocal::focus_stack::{Positions, Sweep};
use parfocal::image_io::Input;
use parfocal::{DeviceInfo, Solution};

use crate::cli::batch::batch_summary::{Outcome, REPORT, Row};
use crate::cli::batch::on_done::OnDone;
use crate::cli::batch::pairs::Group;
use crate::cli::jobs::request::Request;
use crate::cli::jobs::sweep_work::{self, SweepFrames, SweepJob};
use crate::cli::jobs::work::{self, Job, Photographs};
use crate::cli::output::failure::Failure;

/// What is the same for all pairs.
pub(crate) struct Shared {
    pub(crate) request: Request,
    pub(crate) resume: bool,
    /// What they are solved on; of several devices the one with the least memory.
    pub(crate) device: DeviceInfo,
    /// Set by Ctrl-C.
    pub(crate) stop: Arc<AtomicBool>,
    /// What is run of each that was solved.
    pub(crate) on_done: Option<OnDone>,
}

/// A pair or a sweep, and what its results are called.
pub(crate) struct Named {
    name: String,
    task: Task,
}

enum Task {
    Pair(Job),
    Sweep(SweepJob),
}

/// One on its way from the reader to the solver.
pub(crate) enum Read {
    Photographs(Box<Photographs>),
    Frames(Box<SweepFrames>),
    Whole,
    Failed(Failure),
}

/// One on its way from the solver to the writer.
pub(crate) enum Solved {
    Solution(Box<(Photographs, Solution, DeviceInfo)>),
    Sweep(Box<(SweepFrames, (Sweep, f64), DeviceInfo)>),
    Whole,
    Failed(Failure),
}

impl Named {
    pub(crate) fn new(out: &Path, Group { name, files }: Group) -> Self {
        let out = out.join(&name);
        let task = match <[PathBuf; 2]>::try_from(files) {
            Ok(files) => Task::Pair(Job { files, out }),
            Err(files) => Task::Sweep(SweepJob { files, positions: Positions::Counted, reference: None, out }),
        };
        Self { name, task }
    }

    pub(crate) fn row(&self, outcome: Outcome) -> Row {
        Row::new(&self.name, self.task.files(), self.task.out(), outcome)
    }

    /// Refuses what cannot be done, before any work.
    pub(crate) fn check(&self, request: &Request) -> Result<(), Failure> {
        match &self.task {
            Task::Pair(job) => work::check(request, job),
            Task::Sweep(job) => sweep_work::check(request, job),
        }
    }

    /// Its first photograph, by which messages call it.
    pub(crate) fn first(&self) -> &Path {
        &self.task.files()[0]
    }

    /// Reads the photographs, unless the results are there.
    pub(crate) fn read(&self, shared: &Shared) -> Result<Read, Failure> {
        let request = &shared.request;
        let settled = |inputs: &[Input]| self.task.is_settled(shared, inputs);
        let device = || Ok(shared.device.clone());
        Ok(match &self.task {
            Task::Pair(job) => {
                work::read(request, job, settled, device)?.map_or(Read::Whole, |read| Read::Photographs(Box::new(read)))
            }
            Task::Sweep(job) => sweep_work::read(request, job, settled, device)?
                .map_or(Read::Whole, |read| Read::Frames(Box::new(read))),
        })
    }

    /// Writes what was solved; what is said of it.
    pub(crate) fn write(&self, request: &Request, solved: Solved) -> Result<Outcome, Failure> {
        match (&self.task, solved) {
            (Task::Pair(job), Solved::Solution(solved)) => {
                let (photographs, solution, device) = *solved;
                let report = work::write(request, job, &device, &photographs, &solution)?;
                Outcome::solved(&report)
            }
            (Task::Sweep(job), Solved::Sweep(solved)) => {
                let (frames, sweep, device) = *solved;
                Outcome::solved(&sweep_work::write(request, job, &device, &frames, &sweep)?)
            }
            (_, Solved::Failed(failure)) => Err(failure),
            (task, _) => Outcome::kept(task.out()),
        }
    }
}

impl Task {
    fn files(&self) -> &[PathBuf] {
        match self {
            Self::Pair(job) => &job.files,
            Self::Sweep(job) => &job.files,
        }
    }

    fn out(&self) -> &Path {
        match self {
            Self::Pair(job) => &job.out,
            Self::Sweep(job) => &job.out,
        }
    }

    /// Whether the results are there, all that the report names and as they were written, and of what is asked.
    fn is_settled(&self, shared: &Shared, inputs: &[Input]) -> Result<bool, Failure> {
        if !shared.resume {
            return Ok(false);
        }
        let Some(report) = Outcome::report(self.out())? else { return Ok(false) };
        let digest = match self {
            Self::Pair(_) => shared.request.digest(&[])?,
            Self::Sweep(job) => job.digest(&shared.request)?,
        };
        let is_of = |(i, input): (usize, &Input)| {
            let page = report["inputs"][i]["page"].as_u64().map(|page| page as usize);
            report["inputs"][i]["sha256"].as_str() == Some(&input.sha256) && page == input.page
        };
        let known = report["inputs"].as_array().map_or(0, Vec::len);
        Ok(report["request"].as_str() == Some(&digest)
            && known == inputs.len()
            && inputs.iter().enumerate().all(is_of)
            && is_whole(self.out(), REPORT, &report))
    }
}
