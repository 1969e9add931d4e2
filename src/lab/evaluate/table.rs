//! Tables in Markdown.

/// Columns and rows of text.
pub(super) struct Table {
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
}

/// Stands where there is nothing.
pub(super) const DASH: &str = "–";

impl Table {
    pub(super) fn new<T: Into<String>>(columns: impl IntoIterator<Item = T>) -> Self {
        Self { columns: columns.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// Adds a row; cells that are missing are dashes, those beyond the last column are left out.
    pub(super) fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        let mut row: Vec<String> = cells.into_iter().collect();
        row.resize(self.columns.len(), DASH.to_string());
        self.rows.push(row);
    }

    pub(super) fn markdown(&self) -> String {
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|").replace('\n', " ")).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let rule = format!("|{}\n", " --- |".repeat(self.columns.len()));
        let rows: String = self.rows.iter().map(|row| line(row)).collect();
        line(&self.columns) + &rule + &rows
    }
}

/// Three significant digits; a dash for nothing and for what is no number.
pub(super) fn number(value: impl Into<Option<f64>>) -> String {
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

/// Milliseconds as seconds.
pub(super) fn seconds(ms: impl Into<Option<f64>>) -> String {
    ms.into().map_or(DASH.to_string(), |ms| format!("{:.2}", ms / 1e3))
}

/// "yes", "no", or a dash.
pub(super) fn yes(value: Option<bool>) -> String {
    value.map_or(DASH, |v| if v { "yes" } else { "no" }).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_rectangular_and_escapes_what_would_break_it() {
        let mut table = Table::new(["scene", "|V|"]);
        table.row(["a|b\nc".to_string()]);
        table.row(["x".to_string(), "1".to_string(), "too many".to_string()]);
        assert_eq!(table.markdown(), "| scene | \\|V\\| |\n| --- | --- |\n| a\\|b c | – |\n| x | 1 |\n");
    }

    #[test]
    fn numbers_have_three_digits() {
        let cases = [(0.0, "0"), (0.00123456, "0.00123"), (-12.345, "-12.3"), (1234.5, "1234"), (1e-9, "1.00e-9")];
        for (value, text) in cases {
            assert_eq!(number(value), text);
        }
        assert_eq!((number(None), number(f64::NAN)), (DASH.to_string(), DASH.to_string()));
        assert_eq!((seconds(1234.0), yes(Some(false)), yes(None)), ("1.23".into(), "no".into(), DASH.into()));
    }
}
