//! What is measured and what it must be: sections of cases, each with its figures.

use serde::Serialize;

use super::table::{DASH, Table, number};

/// Cases that are measured alike.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Section {
    pub name: &'static str,
    /// What is measured, on what; sentences.
    pub what: String,
    pub cases: Vec<Case>,
}

/// One pair, or one group of pairs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Case {
    pub name: String,
    pub figures: Vec<Figure>,
    /// What else is to be known; why there is no figure, where there is none.
    pub note: String,
}

/// One number, and what it must be.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Figure {
    /// The quantity, with its unit.
    pub name: &'static str,
    /// `null` where there is no answer.
    pub value: Option<f64>,
    /// The least and the greatest that will do; neither where the figure is told for its own sake.
    pub least: Option<f64>,
    pub most: Option<f64>,
    /// `null` where nothing is demanded. No answer is a miss.
    pub met: Option<bool>,
}

impl Case {
    pub(super) fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), ..Self::default() }
    }

    /// A case that cannot be measured.
    pub(super) fn failed(name: impl Into<String>, why: impl Into<String>) -> Self {
        Self::new(name).note(why)
    }

    pub(super) fn note(mut self, note: impl Into<String>) -> Self {
        self.note = note.into();
        self
    }

    /// A figure for its own sake.
    pub(super) fn told(self, name: &'static str, value: impl Into<Option<f64>>) -> Self {
        self.figure(name, value.into(), [None, None])
    }

    pub(super) fn at_most(self, name: &'static str, value: impl Into<Option<f64>>, most: f64) -> Self {
        self.figure(name, value.into(), [None, Some(most)])
    }

    pub(super) fn within(self, name: &'static str, value: impl Into<Option<f64>>, [least, most]: [f64; 2]) -> Self {
        self.figure(name, value.into(), [Some(least), Some(most)])
    }

    fn figure(mut self, name: &'static str, value: Option<f64>, [least, most]: [Option<f64>; 2]) -> Self {
        let value = value.filter(|v| v.is_finite());
        let keeps = |v: f64| least.is_none_or(|least| v >= least) && most.is_none_or(|most| v <= most);
        let met = (least.is_some() || most.is_some()).then(|| value.is_some_and(keeps));
        self.figures.push(Figure { name, value, least, most, met });
        self
    }
}

impl Figure {
    /// The value beside its bound; in bold where it misses it.
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
    /// How many of the demands are met, and how many there are; a case that could not be measured is one that is not.
    fn met(&self) -> [usize; 2] {
        let failed = self.cases.iter().filter(|case| case.figures.is_empty()).count();
        let judged = || self.cases.iter().flat_map(|case| &case.figures).filter_map(|figure| figure.met);
        [judged().filter(|met| *met).count(), judged().count() + failed]
    }

    /// A heading, what was measured, and a row a case.
    fn markdown(&self) -> String {
        let mut names: Vec<&str> = Vec::new();
        for figure in self.cases.iter().flat_map(|case| &case.figures) {
            if !names.contains(&figure.name) {
                names.push(figure.name);
            }
        }
        let mut table = Table::new(["case"].into_iter().chain(names.iter().copied()).chain(["note"]));
        for case in &self.cases {
            let cell =
                |name: &&str| case.figures.iter().find(|f| f.name == *name).map_or(DASH.to_string(), Figure::cell);
            let cells = names.iter().map(cell);
            table.row([case.name.clone()].into_iter().chain(cells).chain([case.note.clone()]));
        }
        let [met, of] = self.met();
        format!("### {}: {met} of {of} met\n\n{}\n\n{}", self.name, self.what, table.markdown())
    }
}

/// A part of the report under a heading; nothing where nothing was measured.
pub(super) fn markdown(heading: &str, sections: &[Section]) -> String {
    if sections.is_empty() {
        return String::new();
    }
    let sum = |n: usize| sections.iter().map(|section| section.met()[n]).sum::<usize>();
    let text: Vec<String> = sections.iter().map(Section::markdown).collect();
    format!("## {heading}\n\nDefault settings: {} of {} bounds are met.\n\n{}", sum(0), sum(1), text.join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_is_met_missed_or_none() {
        let case = Case::new("a").at_most("x", 2.0, 2.0).at_most("y", f64::NAN, 1.0).within("z", -0.3, [-0.2, 0.2]);
        let case = case.told("w", 7.0).note("n");
        assert_eq!(
            case.figures.iter().map(|f| f.met).collect::<Vec<_>>(),
            [Some(true), Some(false), Some(false), None]
        );
        let section = Section { name: "s", what: "What.".to_string(), cases: vec![case, Case::failed("b", "absent")] };
        assert_eq!(section.met(), [1, 4]);
        let text = "### s: 1 of 4 met\n\nWhat.\n\n| case | x | y | z | w | note |\n| --- | --- | --- | --- | --- | --- |\n\
                    | a | 2.00 ≤ 2.00 | **–** not ≤ 1.00 | **-0.300** not in -0.200 to 0.200 | 7.00 | n |\n\
                    | b | – | – | – | – | absent |\n";
        assert_eq!(section.markdown(), text);
    }
}
