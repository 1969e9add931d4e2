//! Pairs under way in the slots of a solver: handed over, waited for, called off.

use std::time::Duration;

use crate::base::{Error, Frame};
use crate::engine::source::{Source, Way};
use crate::engine::vulkan::{DeviceSolution, DeviceSource, ExternalCommandBuffer, SemaphoreWait, SourceCopy};
use crate::engine::{PairSolver, SolutionRef, same_size};

/// A pair that was [submitted](PairSolver::submit).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ticket {
    slot: usize,
    pair: u64,
    fetched: [bool; 2],
}

impl Ticket {
    /// Which of the two photographs the device itself fetches; the others were copied by the host before `submit` returned, or written in place.
    pub fn is_fetched(&self) -> [bool; 2] {
        self.fetched
    }
}

impl PairSolver {
    /// Hands a pair to the device in a slot, counted from 0, whose earlier pair is waited for, and comes back while the device works. (A device
    /// that cannot leave commands out by itself, VK_EXT_conditional_rendering, has to be asked in between: it is waited for.)
    ///
    /// # Errors
    /// As [`PairSolver::solve`]; [`Error::Mismatch`] where there is no such slot.
    pub fn submit(&mut self, slot: usize, i1: &Frame, i2: &Frame) -> Result<Ticket, Error> {
        same_size([i1, i2])?;
        self.submit_sources(slot, [Source::Frame(i1), Source::Frame(i2)], &[])
    }

    /// The same of photographs from anywhere, which the device reads once what is waited for has happened.
    ///
    /// # Errors
    /// As [`PairSolver::submit`]; [`Error::NoKeyPoints`] with the method SIFT, which takes frames.
    pub fn submit_sources(
        &mut self,
        slot: usize,
        sources: [Source<'_>; 2],
        waits: &[SemaphoreWait],
    ) -> Result<Ticket, Error> {
        let fetches = self.bring_up(slot, sources)?;
        let lane = &mut self.lanes[slot];
        if fetches.is_empty() {
            lane.submit(waits)?;
        } else {
            lane.fetch(&fetches, waits)?;
            lane.submit(&[])?;
        }
        Ok(self.ticket(slot, &fetches))
    }

    /// Lends the memory of a slot that the device reads a photograph from, I1 (0) or I2 (1), once the slot's earlier pair is solved: rows one after the
    /// other without gaps, as the solver's format packs them. What is written there is a [`Source::Written`] of the next pair.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where there is no such slot or photograph; [`Error::Timeout`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn input(&mut self, slot: usize, image: usize) -> Result<&mut [u8], Error> {
        self.check_slot(slot)?;
        if image > 1 {
            return Err(Error::Mismatch(format!("there is no photograph {image} of a pair: they are 0 and 1")));
        }
        let bytes = self.common.plan.packed_bytes(image) as usize;
        self.lanes[slot].rest()?;
        Ok(&mut self.lanes[slot].entry(image).mapped_mut()?[..bytes])
    }

    /// Records a solve of photographs on the device into a command buffer of the embedding program's, which then executes it, once or as often as
    /// it fills them anew; the host is asked nothing in between. [`PairSolver::on_device`] names the buffer that the results are in for commands after a
    /// barrier; what is not yet done of a pair that was called off or has settled runs over nothing. When it is solved the program knows:
    /// [`PairSolver::poll`], [`PairSolver::wait`] and [`PairSolver::wait_taken`] take it for done, and the semaphore of [`PairSolver::on_device`] says nothing of it. The
    /// contract is that of [`ExternalCommandBuffer::new`].
    ///
    /// # Errors
    /// As [`PairSolver::submit_sources`].
    pub fn encode(
        &mut self,
        slot: usize,
        commands: ExternalCommandBuffer,
        sources: [DeviceSource; 2],
    ) -> Result<Ticket, Error> {
        let fetches = self.bring_up(slot, sources.map(Source::OnDevice))?;
        self.lanes[slot].encode(commands, &fetches)?;
        Ok(self.ticket(slot, &fetches))
    }

    fn ticket(&self, slot: usize, fetches: &[(usize, SourceCopy)]) -> Ticket {
        let fetched = [0, 1].map(|image| fetches.iter().any(|(of, _)| *of == image));
        Ticket { slot, pair: self.lanes[slot].pairs(), fetched }
    }

    /// Waits so long at most for a pair, and lends its results; `None` where it is not solved by then.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where another pair has taken the slot since; [`Error::Cancelled`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn wait(&mut self, ticket: &Ticket, limit: Duration) -> Result<Option<SolutionRef<'_>>, Error> {
        self.check_ticket(ticket)?;
        let lane = &mut self.lanes[ticket.slot];
        if !lane.wait(limit)? {
            return Ok(None);
        }
        lane.view(self.mask.as_ref()).map(Some)
    }

    /// Waits so long at most for the device to have fetched what it fetches of a pair; whether it has: then it may be overwritten.
    ///
    /// # Errors
    /// As [`PairSolver::wait`].
    pub fn wait_taken(&mut self, ticket: &Ticket, limit: Duration) -> Result<bool, Error> {
        self.check_ticket(ticket)?;
        self.lanes[ticket.slot].is_taken(limit)
    }

    /// Whether a pair is solved, or was called off and the device has left the rest of it out; waits for nothing.
    ///
    /// # Errors
    /// As [`PairSolver::wait`].
    pub fn poll(&mut self, ticket: &Ticket) -> Result<bool, Error> {
        self.check_ticket(ticket)?;
        self.lanes[ticket.slot].wait(Duration::ZERO)
    }

    /// Calls a pair off: the device soon leaves the rest of it out, the ticket gives [`Error::Cancelled`], and the slot takes another pair.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where another pair has taken the slot since.
    pub fn cancel(&self, ticket: &Ticket) -> Result<(), Error> {
        self.check_ticket(ticket)?;
        self.lanes[ticket.slot].cancel();
        Ok(())
    }

    /// Where on the device the results of a pair will be, and what says that they are there: for programs that go on with them on the same
    /// device ([`Engine::from_vulkan`](crate::Engine::from_vulkan)), without the host in between.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where another pair has taken the slot since.
    pub fn on_device(&self, ticket: &Ticket) -> Result<DeviceSolution, Error> {
        self.check_ticket(ticket)?;
        Ok(self.lanes[ticket.slot].on_device())
    }

    fn check_ticket(&self, ticket: &Ticket) -> Result<(), Error> {
        self.check_slot(ticket.slot)?;
        if self.lanes[ticket.slot].pairs() == ticket.pair {
            return Ok(());
        }
        Err(Error::Mismatch(format!("another pair has taken slot {} since", ticket.slot)))
    }

    fn check_slot(&self, slot: usize) -> Result<(), Error> {
        let count = self.lanes.len();
        if slot < count {
            return Ok(());
        }
        Err(Error::Mismatch(format!("there is no slot {slot}: the solver has {count}, counted from 0")))
    }

    /// Brings the frames of a pair up into the first slot.
    pub(super) fn bring_frames(&mut self, i1: &Frame, i2: &Frame) -> Result<(), Error> {
        same_size([i1, i2])?;
        self.bring_up(0, [Source::Frame(i1), Source::Frame(i2)]).map(drop)
    }

    /// Brings a pair up into a slot, but for what the device is to fetch.
    fn bring_up(&mut self, slot: usize, sources: [Source<'_>; 2]) -> Result<Vec<(usize, SourceCopy)>, Error> {
        self.check_slot(slot)?;
        let (common, lane) = (self.common.clone(), &mut self.lanes[slot]);
        let [first, second] = [0, 1].map(|image| sources[image].way(&common.plan, image, &common.device));
        let ways = [first?, second?];
        lane.begin(&self.cancel)?;
        let frames = if let [Way::Frame(i1), Way::Frame(i2)] = ways { Some([i1, i2]) } else { None };
        let mut is_masked = self.mask.is_some() || frames.is_none();
        let mut fetches = Vec::new();
        for (image, way) in ways.into_iter().enumerate() {
            match way {
                Way::There => {}
                Way::Frame(frame) => {
                    let levels = common.plan.settings.clipped(frame.format().depth);
                    lane.fill(image, &mut |bytes| is_masked |= frame.copy_samples(bytes, levels))?;
                }
                Way::Rows(rows) => {
                    let mut are_numbers = true;
                    lane.fill(image, &mut |bytes| are_numbers = rows.bring(bytes))?;
                    if !are_numbers {
                        let problem = "a sample is not finite, or beyond 1e6: white is 1";
                        return Err(Error::Mismatch(format!("photograph {}: {problem}", image + 1)));
                    }
                }
                Way::Fetch(fetch) => fetches.push((image, fetch)),
            }
        }
        let start = self.start(frames)?;
        self.lanes[slot].take(&start, is_masked)?;
        Ok(fetches)
    }
}
