//! A model of the time of solves on GPUs that this machine does not have. `tools/gpu-model` runs it.
//!
//! Mesa's RADV compiles shaders for an AMD GPU on a machine without one, and states the registers, instructions and
//! cycles of each pipeline. The engine's scripts state each dispatch, its workgroups and its compulsory traffic. A
//! dispatch takes
//!
//! ```text
//! max(waves * inverse throughput / (SIMDs * clock),  bytes / bandwidth,  latency / clock) + overhead
//! ```
//!
//! A wave has 64 invocations. The inverse throughput is the cycles per wave on a full SIMD, the latency those of a wave
//! alone. What the last workgroup of a dispatch does when all others are done adds its latency. The tool lists passes
//! that keep numbers in scratch memory, whose time the compiler's cycles leave out.
//! `docs/performance.md` has the results, and what the model leaves out.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};

use parfocal::internals::model::{Compiler, Pass, Solve, Work};

/// A GPU, by its data sheet.
struct Card {
    name: &'static str,
    /// The chip that shaders are compiled for, as in `RADV_FORCE_FAMILY`.
    chip: &'static str,
    /// Units that each issue one wave's instructions.
    simds: f64,
    /// Boost clock, Hz.
    clock: f64,
    /// Bytes per second.
    bandwidth: f64,
}

/// Radeon RX 6900 XT, Radeon RX 7900 XTX, and H200 SXM: 132 multiprocessors of four schedulers. Mesa does not compile
/// for the last, so a wave is taken to need as many cycles as on navi21.
const CARDS: [Card; 3] = [
    Card { name: "navi21", chip: "navi21", simds: 160.0, clock: 2.25e9, bandwidth: 512e9 },
    Card { name: "gfx1100", chip: "gfx1100", simds: 192.0, clock: 2.5e9, bandwidth: 960e9 },
    Card { name: "H200", chip: "navi21", simds: 528.0, clock: 1.98e9, bandwidth: 4.8e12 },
];

/// Model the time of solves on GPUs that this machine does not have
#[derive(clap::Args, Debug)]
pub(crate) struct Arguments {
    /// Lists also the passes of the solves with this in their title, as 'navi21, pair, 1 Mpx'
    title: Option<String>,
    /// Writes the totals to docs/performance.md
    #[arg(long)]
    write: bool,
}

/// The driver whose compiler the totals in `docs/performance.md` are from. Another one compiles the shaders
/// differently.
const DRIVER: &str = "Mesa 22.3.6";
/// The file with the totals, which are the bounds of later changes.
const TOTALS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/performance.md");

/// Seconds that a dispatch takes if it waits for those before: they drain and flush the caches. Assumed.
const BARRIER: f64 = 2e-6;
/// Seconds that any other dispatch takes to start. Assumed.
const LAUNCH: f64 = 0.5e-6;

/// What the compiler states about a pipeline.
#[derive(Clone, Copy, Debug, Default)]
struct Compiled {
    registers: u64,
    /// Shared memory of a workgroup, bytes.
    shared: u64,
    /// Waves in flight on a SIMD.
    waves: u64,
    instructions: u64,
    /// Cycles of a wave alone.
    latency: u64,
    /// Cycles per wave on a full SIMD.
    inverse_throughput: u64,
    /// Memory in the place of registers, bytes per wave: arrays that are indexed, and spilled registers.
    scratch: u64,
}

impl Compiled {
    fn new(stated: &BTreeMap<String, u64>) -> Result<Self, String> {
        let of = |name: &str| stated.get(name).copied().ok_or(format!("the driver states {stated:?}, not {name}"));
        Ok(Self {
            registers: of("VGPRs")?,
            shared: of("LDS size")?,
            // The driver counts in waves of 32 invocations (`radv_get_max_waves`).
            waves: of("Subgroups per SIMD")? / 2,
            instructions: of("Instructions")?,
            latency: of("Latency")?,
            inverse_throughput: of("Inverse Throughput")?,
            scratch: of("Scratch size")?,
        })
    }
}

/// A sum over dispatches: their number, and their seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sum {
    dispatches: usize,
    /// Those with no workgroups, and copies.
    others: usize,
    bytes: f64,
    arithmetic: f64,
    traffic: f64,
    latency: f64,
    time: f64,
}

impl Sum {
    /// Adds what an entry takes on a card.
    fn add(&mut self, card: &Card, work: &Work, compiled: &Compiled) {
        let arithmetic = work.rounds * work.waves * compiled.inverse_throughput as f64 / (card.simds * card.clock);
        let traffic = work.bytes / card.bandwidth;
        let latency = if work.waves > 0.0 { work.rounds * compiled.latency as f64 / card.clock } else { 0.0 };
        let overhead = if work.waits { BARRIER } else { LAUNCH };
        self.dispatches += usize::from(work.waves > 0.0);
        self.others += usize::from(work.waves == 0.0);
        self.bytes += work.bytes;
        self.arithmetic += arithmetic;
        self.traffic += traffic;
        self.latency += latency;
        self.time += arithmetic.max(traffic).max(latency) + overhead;
    }

    /// Adds up entries.
    fn of<'a>(card: &Card, work: impl Iterator<Item = &'a Work>, compiled: &HashMap<String, Compiled>) -> Self {
        let mut sum = Self::default();
        let compiled = |pass: Pass| compiled.get(&pass.label()).copied().unwrap_or_default();
        for work in work {
            sum.add(card, work, &compiled(work.pass));
            if let Some((pass, rounds)) = work.last.filter(|_| work.waves > 0.0) {
                let latency = rounds * compiled(pass).latency as f64 / card.clock;
                sum.latency += latency;
                sum.time += latency;
            }
        }
        sum
    }
}

/// The passes of a solve on a card, the slowest first, and its levels.
fn passes(card: &Card, solve: &Solve, work: &[Work], compiled: &HashMap<String, Compiled>) -> String {
    let mut by_pass = BTreeMap::<String, Vec<&Work>>::new();
    work.iter().for_each(|work| by_pass.entry(work.pass.label()).or_default().push(work));
    let sums = by_pass.into_iter().map(|(name, work)| (name, Sum::of(card, work.into_iter(), compiled)));
    let mut sums: Vec<(String, Sum)> = sums.collect();
    sums.sort_by(|(_, a), (_, b)| b.time.total_cmp(&a.time));
    sums.push((Pass::copy("all").label(), Sum::of(card, work.iter(), compiled)));
    let header = ["pass, variant", "dispatches", "others", "registers", "scratch", "shared", "waves", "instructions"];
    let columns = ["arithmetic", "traffic", "latency", "ms"];
    let line = |cells: &[String]| {
        let [name, cells @ ..] = cells else { unreachable!("a row has a name") };
        cells.iter().fold(format!("  {name:<24}"), |line, cell| line + &format!("{cell:>13}")) + "\n"
    };
    let mut text = format!("{}, {}\n", card.name, solve.title);
    text += &line(&header.into_iter().chain(columns).map(String::from).collect::<Vec<_>>());
    for (name, sum) in sums {
        let c = compiled.get(&name).copied().unwrap_or_default();
        let counts =
            [sum.dispatches as u64, sum.others as u64, c.registers, c.scratch, c.shared, c.waves, c.instructions];
        let times = [sum.arithmetic, sum.traffic, sum.latency, sum.time].map(|seconds| format!("{:.3}", 1e3 * seconds));
        let cells = counts.iter().map(u64::to_string).chain(times);
        text += &line(&[name].into_iter().chain(cells).collect::<Vec<_>>());
    }
    let levels = 0..=work.iter().map(|work| work.level).max().unwrap_or(0);
    let level = |n| Sum::of(card, work.iter().filter(|work| work.level == n), compiled).time;
    let levels: Vec<String> = levels.map(|n| format!("{:.3}", 1e3 * level(n))).collect();
    text + &format!("  levels, finest first, ms: {}\n", levels.join(" "))
}

/// The columns of the totals, after the title.
const COLUMNS: usize = 3 + CARDS.len();

/// A row of the table in the documentation.
struct Totals {
    title: String,
    /// Batches, dispatches, kB per pixel, and ms on each card; `None` for a card of another chip.
    numbers: [Option<String>; COLUMNS],
}

impl Totals {
    fn new(title: String, batches: usize, pixels: f64, sums: &[Option<Sum>; CARDS.len()]) -> Self {
        let any = sums.iter().flatten().next().copied().unwrap_or_default();
        let counts = [batches.to_string(), any.dispatches.to_string(), format!("{:.2}", 1e-3 * any.bytes / pixels)];
        let times = sums.map(|sum| sum.map(|sum| format!("{:.2}", 1e3 * sum.time)));
        let mut numbers = counts.map(Some).into_iter().chain(times);
        Self { title, numbers: std::array::from_fn(|_| numbers.next().flatten()) }
    }

    /// The row of the documentation with the same title.
    fn documented<'a>(&self, documentation: &'a str) -> Option<&'a str> {
        documentation.lines().find(|line| line.starts_with(&format!("| {} |", self.title)))
    }

    /// The row, with numbers of the documented one where this run has none.
    fn row(&self, documented: Option<&str>) -> String {
        let before = documented.map_or([""; COLUMNS], numbers_of);
        let cells = self.numbers.iter().zip(before).map(|(now, before)| now.as_deref().unwrap_or(before));
        format!("| {} | {} |", self.title, cells.collect::<Vec<_>>().join(" | "))
    }

    /// Whether a number is larger than the documented one, or there is none.
    fn is_worse(&self, documented: Option<&str>) -> bool {
        let bounds = documented.map_or([""; COLUMNS], numbers_of).map(|bound| bound.parse::<f64>().ok());
        let exceeds = |(now, bound): (&Option<String>, Option<f64>)| {
            now.as_ref().is_some_and(|now| bound.is_none_or(|bound| now.parse::<f64>().is_ok_and(|now| now > bound)))
        };
        self.numbers.iter().zip(bounds).any(exceeds)
    }
}

/// The numbers of a row of the documentation, after the title.
fn numbers_of(row: &str) -> [&str; COLUMNS] {
    let mut cells = row.split('|').skip(2).map(str::trim);
    std::array::from_fn(|_| cells.next().unwrap_or_default())
}

/// The rows of a solve: all of it, and depth edges if it has any.
fn totals(chip: &str, solve: &Solve, work: &[Work], compiled: &HashMap<String, Compiled>) -> Vec<Totals> {
    let sums = |counts: fn(&Work) -> bool| {
        let sum = |card| Sum::of(card, work.iter().filter(|work| counts(work)), compiled);
        CARDS.each_ref().map(|card| (card.chip == chip).then(|| sum(card)))
    };
    let pixels = f64::from(solve.size[0]) * f64::from(solve.size[1]);
    let mut rows = vec![Totals::new(solve.title.clone(), solve.batches(), pixels, &sums(|_| true))];
    if work.iter().any(|work| work.is_at_edges) {
        rows.push(Totals::new(format!("edges of the {}", solve.title), 0, pixels, &sums(|work| work.is_at_edges)));
    }
    rows
}

/// How much longer a solve takes with depth edges than without.
fn cost_of_edges(card: &Card, solve: &Solve, work: &[Work], compiled: &HashMap<String, Compiled>) -> Option<String> {
    let [all, edges] = [|_: &Work| true, |work: &Work| work.is_at_edges]
        .map(|counts| Sum::of(card, work.iter().filter(|work| counts(work)), compiled).time);
    let ratio = all / (all - edges);
    (edges > 0.0).then(|| format!("{}, {}: {ratio:.3} times the time without depth edges\n", card.name, solve.title))
}

/// Prints the totals for the cards of the chip that the environment names, and fails if they exceed those of the
/// documentation.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    let compiler = Compiler::open().map_err(|e| e.to_string())?;
    let chip = std::env::var("RADV_FORCE_FAMILY").map_err(|e| format!("RADV_FORCE_FAMILY: {e}"))?;
    let driver = compiler.driver();
    let before = std::fs::read_to_string(TOTALS).map_err(|e| format!("{TOTALS}: {e}"))?;
    let (mut compiled, mut documentation, mut worse) = (HashMap::new(), before.clone(), String::new());
    println!("{chip} by {driver}; other chips as documented");
    let columns = CARDS.map(|card| format!("{}, ms", card.name)).join(" | ");
    println!("| solve | batches | dispatches | kB per pixel | {columns} |");
    let mut details = String::new();
    for solve in Solve::all().map_err(|e| e.to_string())? {
        let work = solve.work();
        for pass in work.iter().flat_map(|work| [Some(work.pass), work.last.map(|(pass, _)| pass)]).flatten() {
            if let Entry::Vacant(entry) = compiled.entry(pass.label()) {
                let stated = compiler.statistics(pass).map_err(|e| e.to_string())?;
                entry.insert(stated.as_ref().map_or(Ok(Compiled::default()), Compiled::new)?);
            }
        }
        for totals in totals(&chip, &solve, &work, &compiled) {
            let documented = totals.documented(&before);
            let row = totals.row(documented);
            println!("{row}");
            if totals.is_worse(documented) {
                worse += &format!("now:    {row}\nbefore: {}\n", documented.unwrap_or("no such row"));
            }
            documentation = documented.map_or(documentation.clone(), |line| documentation.replace(line, &row));
        }
        for card in CARDS.iter().filter(|card| card.chip == chip) {
            details.extend(cost_of_edges(card, &solve, &work, &compiled));
            let title = format!("{}, {}", card.name, solve.title);
            if arguments.title.as_ref().is_some_and(|part| title.contains(part)) {
                details += &passes(card, &solve, &work, &compiled);
            }
        }
    }
    print!("{details}");
    let in_scratch = compiled.iter().filter(|(_, compiled): &(&String, &Compiled)| compiled.scratch > 0);
    let in_scratch: BTreeMap<_, _> = in_scratch.map(|(pass, compiled)| (pass, compiled.scratch)).collect();
    if !in_scratch.is_empty() {
        println!("bytes of scratch memory per wave: {in_scratch:?}");
    }
    if !driver.contains(DRIVER) {
        println!("NOT COMPARED with docs/performance.md, whose totals are from {DRIVER}: these are from {driver}");
        let problem = format!("docs/performance.md has the totals of {DRIVER}, not of {driver}");
        return if arguments.write { Err(problem) } else { Ok(()) };
    }
    if arguments.write {
        return std::fs::write(TOTALS, documentation).map_err(|e| format!("{TOTALS}: {e}"));
    }
    if !worse.is_empty() {
        return Err(format!(
            "worse than in docs/performance.md:\n{worse}Compare the passes by tools/gpu-model TITLE on both trees. If the \
             change is worth it,\nstate why in its message, and update the table by tools/gpu-model --write"
        ));
    }
    if documentation != before {
        println!("less than in docs/performance.md: update it by tools/gpu-model --write");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const CARD: Card = Card { name: "test", chip: "test", simds: 10.0, clock: 1e9, bandwidth: 1e11 };

    fn work(waves: f64, bytes: f64, waits: bool) -> Work {
        Work { pass: Pass::copy("pass"), waves, bytes, waits, rounds: 1.0, ..Work::default() }
    }

    #[test]
    fn a_dispatch_takes_the_longest_of_three_times_and_its_overhead() {
        let compiled = Compiled { latency: 3000, inverse_throughput: 50, ..Compiled::default() };
        // 1000 waves: 5 µs. 800 kB: 8 µs. One wave: 3 µs.
        for (waves, bytes, waits, us) in [
            (1000.0, 8e5, false, 8.0 + 0.5),
            (1000.0, 8e5, true, 8.0 + 2.0),
            (1000.0, 8e3, false, 5.0 + 0.5),
            (10.0, 8e3, false, 3.0 + 0.5),
            (0.0, 0.0, true, 2.0),
            (0.0, 8e5, true, 8.0 + 2.0),
        ] {
            let mut sum = Sum::default();
            sum.add(&CARD, &work(waves, bytes, waits), &compiled);
            assert!((sum.time - 1e-6 * us).abs() < 1e-15, "{waves} waves, {bytes} bytes: {sum:?}");
            assert_eq!([sum.dispatches, sum.others], if waves > 0.0 { [1, 0] } else { [0, 1] });
        }
        // Half the rounds that the compiler counts: 2.5 µs, and 1.5 µs of one wave.
        let mut sum = Sum::default();
        sum.add(&CARD, &Work { rounds: 0.5, ..work(1000.0, 0.0, false) }, &compiled);
        assert!((sum.time - 3e-6).abs() < 1e-15, "{sum:?}");
    }

    #[test]
    fn sums_are_of_all_dispatches() {
        let compiled = Compiled { latency: 3000, inverse_throughput: 50, ..Compiled::default() };
        let compiled = HashMap::from([(Pass::copy("pass").label(), compiled)]);
        let list = [work(1000.0, 8e5, true), work(0.0, 0.0, true), work(10.0, 8e3, false)];
        let sum = Sum::of(&CARD, list.iter(), &compiled);
        assert_eq!([sum.dispatches, sum.others], [2, 1]);
        let us = [sum.arithmetic, sum.traffic, sum.latency, sum.time].map(|seconds| (1e9 * seconds).round() / 1e3);
        assert_eq!(us, [5.05, 8.08, 6.0, 8.0 + 2.0 + 2.0 + 3.0 + 0.5]);
        // Behind it the last workgroup runs half the rounds of a pass: 1.5 µs.
        let compiled = HashMap::from([(Pass::copy("last").label(), Compiled { latency: 3000, ..Compiled::default() })]);
        let work = Work { last: Some((Pass::copy("last"), 0.5)), ..work(1000.0, 8e5, true) };
        let sum = Sum::of(&CARD, [work].iter(), &compiled);
        assert!((sum.time - 11.5e-6).abs() < 1e-15, "{sum:?}");
    }

    #[test]
    fn totals_are_compared_with_the_row_of_the_same_title() {
        let sum = Sum { dispatches: 20, bytes: 3e9, time: 5e-3, ..Sum::default() };
        let totals = Totals::new("pair, 1 Mpx".to_string(), 7, 1e6, &[Some(sum), None, Some(sum)]);
        let documentation =
            "| pair, 16 Mpx | 1 | 1 | 1 | 1 | 1 | 1 |\n| pair, 1 Mpx | 7 | 20 | 3.00 | 5.00 | 9.00 | 6.00 |\n";
        let row = totals.documented(documentation);
        assert_eq!(totals.row(row), "| pair, 1 Mpx | 7 | 20 | 3.00 | 5.00 | 9.00 | 5.00 |");
        assert!(!totals.is_worse(row));
        for worse in [
            "| pair, 1 Mpx | 6 | 20 | 3.00 | 5.00 | 9.00 | 6.00 |",
            "| pair, 1 Mpx | 7 | 19 | 3.00 | 5.00 | 9.00 | 6.00 |",
            "| pair, 1 Mpx | 7 | 20 | 2.99 | 5.00 | 9.00 | 6.00 |",
            "| pair, 1 Mpx | 7 | 20 | 3.00 | 5.00 | 9.00 | 4.99 |",
            "| pair, 1 Mpx |",
        ] {
            assert!(totals.is_worse(Some(worse)), "{worse}");
        }
        assert!(totals.is_worse(None), "no row");
    }
}
