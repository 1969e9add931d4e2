//! Sections of a report: cases, each a row of values with their bounds, as Markdown and JSON; and what measures them.

use parfocal::{
    Engine, Error, Frame, PairSolver, Settings, Solution, SolveOptions,
    results::Registered,
    settings::{Decode, Kernel, Method},
    transform::Homography,
};
use serde::Serialize;

/// A group of cases with the same values.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Section {
    pub name: String,
    /// The measured values and their data; sentences.
    pub what: String,
    /// Whether its values have bounds. If so, a case that cannot be measured misses a bound.
    #[serde(skip)]
    bounded: bool,
    pub cases: Vec<Case>,
}

/// One pair, or one group of pairs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Case {
    pub name: String,
    pub values: Vec<Value>,
    /// Remarks; the reason if there is no value.
    pub note: String,
}

/// One number with its bounds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Value {
    /// The quantity, with its unit.
    pub name: &'static str,
    /// The number; `null` for no result.
    pub value: Option<f64>,
    /// The lower bound; `null` for none.
    pub least: Option<f64>,
    /// The upper bound; `null` for none.
    pub most: Option<f64>,
    /// Whether the bounds are met; `null` for a value without bounds. A missing result misses its bounds.
    pub met: Option<bool>,
}

impl Case {
    pub(crate) fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), ..Self::default() }
    }

    /// Makes a case that cannot be measured, with the reason.
    pub(crate) fn failed(name: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::new(name).note(reason)
    }

    pub(crate) fn note(mut self, note: impl Into<String>) -> Self {
        self.note = note.into();
        self
    }

    /// Adds a value without bounds.
    pub(crate) fn value(self, name: &'static str, value: impl Into<Option<f64>>) -> Self {
        self.bounded(name, value, [None, None])
    }

    pub(crate) fn at_most(self, name: &'static str, value: impl Into<Option<f64>>, most: f64) -> Self {
        self.bounded(name, value, [None, Some(most)])
    }

    pub(crate) fn within(self, name: &'static str, value: impl Into<Option<f64>>, [least, most]: [f64; 2]) -> Self {
        self.bounded(name, value, [Some(least), Some(most)])
    }

    pub(crate) fn bounded(
        mut self,
        name: &'static str,
        value: impl Into<Option<f64>>,
        [least, most]: [Option<f64>; 2],
    ) -> Self {
        let value = value.into().filter(|v| v.is_finite());
        let meets = |v: f64| least.is_none_or(|least| v >= least) && most.is_none_or(|most| v <= most);
        let met = (least.is_some() || most.is_some()).then(|| value.is_some_and(meets));
        self.values.push(Value { name, value, least, most, met });
        self
    }

    /// The value of this name; `None` if there is none.
    pub(crate) fn get(&self, name: &str) -> Option<f64> {
        self.values.iter().find(|value| value.name == name)?.value
    }
}

impl Value {
    /// The value with its bound, in bold if it misses the bound.
    fn cell(&self) -> String {
        let value = number(self.value);
        let bound = match (self.least, self.most) {
            (None, None) => return value,
            (Some(least), Some(most)) => format!("in {} to {}", number(least), number(most)),
            (Some(least), None) => format!("≥ {}", number(least)),
            (None, Some(most)) => format!("≤ {}", number(most)),
        };
        if self.met == Some(true) { format!("{value} {bound}") } else { format!("**{value}** not {bound}") }
    }
}

impl Section {
    pub(crate) fn new(name: impl Into<String>, what: impl Into<String>, cases: Vec<Case>) -> Self {
        Self { name: name.into(), what: what.into(), bounded: true, cases }
    }

    pub(crate) fn without_bounds(name: impl Into<String>, what: impl Into<String>, cases: Vec<Case>) -> Self {
        Self { bounded: false, ..Self::new(name, what, cases) }
    }

    /// The number of bounds that are met, and the number of bounds. A case without values counts as one missed bound.
    fn met(&self) -> [usize; 2] {
        let failed = self.cases.iter().filter(|case| self.bounded && case.values.is_empty()).count();
        let bounded = || self.cases.iter().flat_map(|case| &case.values).filter_map(|value| value.met);
        [bounded().filter(|met| *met).count(), bounded().count() + failed]
    }

    /// A heading, a description, and a table with a row for each case and a column for each value.
    fn markdown(&self) -> String {
        let mut columns: Vec<&str> = Vec::new();
        for value in self.cases.iter().flat_map(|case| &case.values) {
            if !columns.contains(&value.name) {
                columns.push(value.name);
            }
        }
        let line = |cells: Vec<String>| {
            let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|").replace('\n', " ")).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let head = ["case"].into_iter().chain(columns.iter().copied()).chain(["note"]).map(String::from).collect();
        let mut table = line(head) + &format!("|{}\n", " --- |".repeat(columns.len() + 2));
        for case in &self.cases {
            let cell = |name: &&str| case.values.iter().find(|v| v.name == *name).map_or(DASH.into(), Value::cell);
            let cells = columns.iter().map(cell);
            table += &line([case.name.clone()].into_iter().chain(cells).chain([case.note.clone()]).collect());
        }
        let heading = match self.met() {
            [_, 0] => self.name.clone(),
            [met, of] => format!("{}: {met} of {of} met", self.name),
        };
        format!("### {heading}\n\n{}\n\n{table}", self.what)
    }
}

/// A part of the report under a heading; empty without sections.
pub(crate) fn markdown(heading: &str, sections: &[Section]) -> String {
    if sections.is_empty() {
        return String::new();
    }
    let sum = |n: usize| sections.iter().map(|section| section.met()[n]).sum::<usize>();
    let text: Vec<String> = sections.iter().map(Section::markdown).collect();
    format!("## {heading}\n\n{} of {} bounds are met.\n\n{}", sum(0), sum(1), text.join("\n"))
}

/// The text for a missing value.
const DASH: &str = "–";

/// Formats a number with three significant digits; a dash if it is missing or not finite.
pub(crate) fn number(value: impl Into<Option<f64>>) -> String {
    let Some(value) = value.into().filter(|v| v.is_finite()) else { return DASH.to_string() };
    if value == 0.0 {
        return "0".to_string();
    }
    let exponent = value.abs().log10().floor() as i32;
    match exponent {
        -7..=5 => format!("{value:.*}", (2 - exponent).max(0) as usize),
        _ => format!("{value:.2e}"),
    }
}

/// The compared methods, in the paper's order.
pub(crate) const METHODS: [Method; 3] = [Method::Appearance, Method::Sift, Method::Unified];

/// Number of solvers that are kept, one for each method.
const MOST_SOLVERS: usize = METHODS.len();

/// Solves pairs with reused solvers, and logs the current work.
pub(crate) struct Runner<'a> {
    pub(crate) engine: &'a Engine,
    /// Small scenes and few cases.
    pub(crate) quick: bool,
    log: &'a mut dyn FnMut(&str),
    /// The kept solvers; the last one was used last.
    solvers: Vec<PairSolver>,
}

impl<'a> Runner<'a> {
    pub(crate) fn new(engine: &'a Engine, quick: bool, log: &'a mut dyn FnMut(&str)) -> Self {
        Self { engine, quick, log, solvers: Vec::new() }
    }

    pub(crate) fn log(&mut self, line: &str) {
        (self.log)(line);
    }

    /// Measures one case; an error becomes a case without values.
    pub(crate) fn case(
        &mut self,
        section: &str,
        name: impl Into<String>,
        measure: impl FnOnce(&mut Self, Case) -> Result<Case, String>,
    ) -> Case {
        let name = name.into();
        self.log(&format!("{section}: {name}"));
        measure(self, Case::new(name.clone())).unwrap_or_else(|e| Case::failed(name, e))
    }

    pub(crate) fn solve(&mut self, [i1, i2]: [&Frame; 2], settings: &Settings) -> Result<Solution, String> {
        self.attempt([i1, i2], settings, &SolveOptions::default()).map_err(|e| e.to_string())
    }

    /// Solves a pair. The error shows whether the pair was refused.
    pub(crate) fn attempt(
        &mut self,
        frames: [&Frame; 2],
        settings: &Settings,
        options: &SolveOptions,
    ) -> Result<Solution, Error> {
        self.solver(settings)?.solve(frames, options)
    }

    pub(crate) fn register(&mut self, [i1, i2]: [&Frame; 2], settings: &Settings) -> Result<Registered, String> {
        self.solver(settings).and_then(|s| s.register([i1, i2], &SolveOptions::default())).map_err(|e| e.to_string())
    }

    fn solver(&mut self, settings: &Settings) -> Result<&mut PairSolver, Error> {
        let solver = match self.solvers.iter().position(|solver| solver.settings() == settings) {
            Some(place) => self.solvers.remove(place),
            None => {
                // Drops the oldest solver before preparing the next, to free its memory.
                if self.solvers.len() == MOST_SOLVERS {
                    self.solvers.remove(0);
                }
                PairSolver::new(self.engine, settings)?
            }
        };
        self.solvers.push(solver);
        let last = self.solvers.len() - 1;
        Ok(&mut self.solvers[last])
    }
}

/// The default settings with a method and a kernel, with samples as stored.
pub(crate) fn settings(method: Method, kernel: &Kernel) -> Settings {
    Settings { method, kernel: kernel.clone(), decode: Decode::None, ..Settings::default() }
}

/// Settings that hold T at the identity.
pub(crate) fn unregistered(kernel: &Kernel) -> Settings {
    Settings { start: Homography::IDENTITY, ..settings(Method::Aligned, kernel) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_is_met_missed_or_absent() {
        let case = Case::new("a|b").at_most("x", 2.0, 2.0).at_most("y", f64::NAN, 1.0).within("z", -0.3, [-0.2, 0.2]);
        let case = case.value("w", 7.0).note("n");
        assert_eq!(case.values.iter().map(|f| f.met).collect::<Vec<_>>(), [Some(true), Some(false), Some(false), None]);
        assert_eq!((case.get("z"), case.get("y"), case.get("v")), (Some(-0.3), None, None));
        let section = Section::new("s", "What.", vec![case, Case::failed("b", "absent")]);
        assert_eq!(section.met(), [1, 4]);
        let text = "### s: 1 of 4 met\n\nWhat.\n\n| case | x | y | z | w | note |\n| --- | --- | --- | --- | --- | --- |\n\
                    | a\\|b | 2.00 ≤ 2.00 | **–** not ≤ 1.00 | **-0.300** not in -0.200 to 0.200 | 7.00 | n |\n\
                    | b | – | – | – | – | absent |\n";
        assert_eq!(section.markdown(), text);
    }

    #[test]
    fn numbers_have_three_digits() {
        let cases = [(0.0, "0"), (0.00123456, "0.00123"), (-12.345, "-12.3"), (1234.5, "1234"), (1e-9, "1.00e-9")];
        for (value, text) in cases {
            assert_eq!(number(value), text);
        }
        assert_eq!((number(None), number(f64::NAN)), (DASH.to_string(), DASH.to_string()));
    }
}
