//! The table of a gauge study: CSV with the columns operator, part, and value or results.

use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use parfocal::internals::bounded_read;

use crate::cli::output::failure::Failure;

/// Greatest size of a table, 16 MiB.
const MAX_BYTES: u64 = 16 << 20;
/// Greatest number of rows.
const MOST_ROWS: usize = 10_000;

/// A row of the table.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    /// The operator; empty without the column.
    pub(crate) operator: String,
    /// The part; empty without the column.
    pub(crate) part: String,
    /// What was measured.
    pub(crate) measured: Measured,
}

/// What a row states.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Measured {
    Value(f64),
    /// A folder of results.
    Results(PathBuf),
}

/// Reads a table. Returns its rows and the unit of its values, which is empty if the table does not state one.
///
/// # Errors
/// [`Failure::Failed`], which names the file and the line.
pub(crate) fn read(file: &Path) -> Result<(Vec<Row>, String), Failure> {
    let failed = |problem: String| Failure::file(file, problem);
    let text = bounded_read::text(file, MAX_BYTES).map_err(|e| match e.kind() {
        ErrorKind::FileTooLarge => failed("is too long for the table of a study; give up to 10000 rows".to_string()),
        _ => failed(format!("cannot be read as the table of a study ({e}); give a CSV file")),
    })?;
    parse(&text, file.parent().unwrap_or(Path::new(""))).map_err(failed)
}

const COLUMNS: &str = "give a header of operator, part, and value (or value_UNIT) or results";

/// Parses a table. Its folders are relative to `folder`.
fn parse(text: &str, folder: &Path) -> Result<(Vec<Row>, String), String> {
    let first = text.lines().next().unwrap_or_default();
    // Spreadsheets write semicolons where the comma is the decimal separator.
    let delimiter = [b';', b'\t'].into_iter().find(|mark| !first.contains(',') && first.as_bytes().contains(mark));
    let mut reader = csv::ReaderBuilder::new()
        .delimiter(delimiter.unwrap_or(b','))
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let written = reader.headers().map_err(|e| format!("is not CSV ({e})"))?.clone();
    let header: Vec<String> = written.iter().map(str::to_lowercase).collect();
    let column = |name: &str| header.iter().position(|cell| cell == name);
    let value = header.iter().position(|cell| cell == "value" || cell.starts_with("value_"));
    let (operator, part, trial, results) = (column("operator"), column("part"), column("trial"), column("results"));
    let (Some(measured), true) = (value.or(results), value.is_some() != results.is_some()) else {
        return Err(format!("has the columns {}; {COLUMNS}", header.join(", ")));
    };
    let known = [operator, part, trial, Some(measured)];
    if let Some(other) = (0..header.len()).find(|n| !known.contains(&Some(*n))) {
        return Err(format!("has an unknown column '{}'; {COLUMNS}, and trial if you like", header[other]));
    }
    // The unit keeps its case.
    let unit = written[measured].split_once('_').map_or("", |(_, unit)| unit).to_string();
    let (mut rows, mut seen) = (Vec::new(), BTreeSet::new());
    for record in reader.records() {
        let record =
            record.map_err(|e| format!("line {}: is not CSV ({e})", e.position().map_or(0, csv::Position::line)))?;
        let line = record.position().map_or(0, csv::Position::line);
        let cell = |column: Option<usize>| column.and_then(|n| record.get(n)).unwrap_or_default();
        let of = [operator, part, trial];
        if let Some(empty) = of.into_iter().flatten().find(|n| cell(Some(*n)).is_empty()) {
            return Err(format!("line {line}: has no {}; fill each cell", header[empty]));
        }
        if trial.is_some() && !seen.insert(of.map(|n| cell(n).to_string())) {
            let [operator, part, trial] = of.map(cell);
            let problem = format!("trial '{trial}' of operator '{operator}' and part '{part}'");
            return Err(format!("line {line}: {problem} is there twice; give each once"));
        }
        let stated = cell(Some(measured));
        let measured = match value {
            Some(_) => {
                // A decimal comma is possible if commas do not separate cells.
                let number = if delimiter.is_some() { stated.replace(',', ".") } else { stated.to_string() };
                let number = number.parse().ok().filter(|v: &f64| v.is_finite() && v.abs() <= 1e12);
                Measured::Value(number.ok_or_else(|| format!("line {line}: '{stated}' is no value; give a number"))?)
            }
            None if stated.is_empty() => return Err(format!("line {line}: names no results; give their folder")),
            None => Measured::Results(folder.join(stated)),
        };
        rows.push(Row { operator: cell(operator).to_string(), part: cell(part).to_string(), measured });
        if rows.len() > MOST_ROWS {
            return Err(format!("has more than {MOST_ROWS} rows; split the study"));
        }
    }
    if rows.len() < 2 {
        return Err(format!("has {} rows; give two or more", rows.len()));
    }
    Ok((rows, unit))
}

/// Reads a file, for fuzz tests.
#[cfg(test)]
pub(crate) fn reads(file: &Path) {
    let _ = read(file);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<(Vec<Row>, String), String> {
        parse(text, Path::new("at"))
    }

    #[test]
    fn tables_of_values_and_of_results_are_read() {
        let (rows, unit) = parsed("Operator,Part,Trial,value_mm\nA,1,1,0.5\nA,1,2,-1e-3\n").unwrap();
        assert_eq!((rows.len(), unit.as_str(), &rows[1].measured), (2, "mm", &Measured::Value(-1e-3)));
        assert_eq!((rows[0].operator.as_str(), rows[0].part.as_str()), ("A", "1"));
        let (rows, unit) = parsed("part;operator;value\n1;A;0,25\n2;A;1\n").unwrap();
        assert_eq!((&rows[0].measured, unit.as_str()), (&Measured::Value(0.25), ""));
        let (rows, _) = parsed("results\nfirst\n\"/abs/second\"\n").unwrap();
        assert_eq!(rows[0].measured, Measured::Results("at/first".into()));
        assert_eq!(rows[1].measured, Measured::Results("/abs/second".into()));
    }

    #[test]
    fn a_unit_keeps_its_case() {
        assert_eq!(parsed("Value_MPa\n1\n2\n").unwrap().1, "MPa");
    }

    #[test]
    fn an_error_states_line_and_fix() {
        for (text, parts) in [
            ("operator,part\nA,1\n", &["operator, part", "give a header"][..]),
            ("value,results\n1,a\n", &["give a header"]),
            ("value,date\n1,a\n2,b\n", &["unknown column 'date'"]),
            ("value\n1\nx\n", &["line 3", "'x' is no value"]),
            ("value\n1\nnan\n", &["line 3"]),
            ("value\n1\n", &["1 rows"]),
            ("", &["give a header"]),
            ("results\na\n\"\"\n", &["line 3", "give their folder"]),
            ("operator,part,value\nA,1,2\n,1,2\n", &["line 3", "has no operator"]),
            ("operator,part,value\nA,,2\nA,1,2\n", &["line 2", "has no part"]),
            ("trial,part,value\n1,a,2\n1,b,2\n1,a,3\n", &["line 4", "trial '1'", "part 'a' is there twice"]),
            ("part,value\n1\n", &["line 2", "is not CSV"]),
        ] {
            let problem = parsed(text).unwrap_err();
            assert!(parts.iter().all(|part| problem.contains(part)), "{problem}");
        }
    }
}
