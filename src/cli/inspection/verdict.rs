//! The verdicts of a batch: of each part one, and all as CSV and JUnit.

use std::fmt::Write;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use parfocal::metric::inspect::Verdict;
use serde::Serialize;

use crate::cli::output::failure::{Failure, plain};

#[derive(Clone, Debug, Serialize)]
pub(crate) struct PartVerdict {
    /// The serial number: the name of the pair or the sweep.
    pub(crate) serial: String,
    /// When the photographs were last changed: UTC, RFC 3339; null if they are gone.
    pub(crate) time: Option<String>,
    /// When the verdict was reached.
    pub(crate) judged: String,
    pub(crate) verdict: Verdict,
    /// Reasons for any verdict but go; one sentence each.
    pub(crate) reasons: Vec<String>,
    /// Time from the photographs to the verdict, s; null if the part was not solved now.
    pub(crate) seconds: Option<f64>,
}

impl PartVerdict {
    /// The reasons in one line.
    pub(crate) fn reason(&self) -> String {
        plain(&self.reasons.join("; "))
    }
}

/// The number of each verdict, and the times.
#[derive(Debug, Serialize)]
pub(crate) struct VerdictCounts {
    pub(crate) go: usize,
    pub(crate) no_go: usize,
    pub(crate) cannot_judge: usize,
    /// Quantiles of the time from the photographs to the verdict, s.
    pub(crate) seconds_p50: Option<f64>,
    pub(crate) seconds_p99: Option<f64>,
}

impl VerdictCounts {
    pub(crate) fn of<'a>(verdicts: impl Iterator<Item = &'a PartVerdict> + Clone) -> Self {
        let count = |wanted: Verdict| verdicts.clone().filter(|part| part.verdict == wanted).count();
        let mut seconds: Vec<f64> = verdicts.clone().filter_map(|part| part.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        // The least time that this share of the parts does not exceed.
        let quantile = |share: f64| {
            let rank = (share * seconds.len() as f64).ceil() as usize;
            seconds.get(rank.saturating_sub(1)).copied()
        };
        Self {
            go: count(Verdict::Go),
            no_go: count(Verdict::NoGo),
            cannot_judge: count(Verdict::CannotJudge),
            seconds_p50: quantile(0.5),
            seconds_p99: quantile(0.99),
        }
    }

    /// The line of the summary.
    pub(crate) fn line(&self) -> String {
        let times = self.seconds_p50.zip(self.seconds_p99).map_or_else(String::new, |(half, most)| {
            format!("; from photographs to verdict p50 {half:.2} s, p99 {most:.2} s")
        });
        format!("{} go, {} no-go, {} cannot judge{times}", self.go, self.no_go, self.cannot_judge)
    }

    /// Fails with the status of the worst verdict.
    pub(crate) fn check(&self) -> Result<(), Failure> {
        match self {
            _ if self.no_go > 0 => Err(Failure::NoGo),
            _ if self.cannot_judge > 0 => Err(Failure::CannotJudge),
            _ => Ok(()),
        }
    }
}

/// The first line of a table of verdicts.
const COLUMNS: [&str; 7] = ["serial", "time", "judged", "verdict", "seconds", "reasons", "output"];

/// The verdicts as CSV, each with its folder of results.
pub(crate) fn csv<'a>(verdicts: impl Iterator<Item = (&'a PartVerdict, &'a str)>) -> Result<Vec<u8>, Failure> {
    let failed = |e: csv::Error| Failure::Failed(format!("verdicts cannot be written as CSV ({e})"));
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(COLUMNS).map_err(failed)?;
    for (part, output) in verdicts {
        let seconds = part.seconds.map_or_else(String::new, |seconds| format!("{seconds:.3}"));
        let time = part.time.as_deref().unwrap_or_default();
        let (serial, output, reason) = (plain(&part.serial), plain(output), part.reason());
        let cells = [&serial, time, &part.judged, part.verdict.name(), &seconds, &reason, &output];
        table.write_record(cells).map_err(failed)?;
    }
    table.into_inner().map_err(|e| failed(e.into_error().into()))
}

/// The verdicts as JUnit: no-go is a failure, cannot judge an error.
pub(crate) fn junit<'a>(source: &str, verdicts: impl Iterator<Item = &'a PartVerdict> + Clone) -> String {
    let counts = VerdictCounts::of(verdicts.clone());
    let all = counts.go + counts.no_go + counts.cannot_judge;
    let seconds: f64 = verdicts.clone().filter_map(|part| part.seconds).sum();
    let mut text = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites>\n  <testsuite name=\"parfocal\" tests=\"{all}\" \
         failures=\"{}\" errors=\"{}\" skipped=\"0\" time=\"{seconds:.3}\">\n",
        counts.no_go, counts.cannot_judge
    );
    let source = escaped(source);
    for part in verdicts {
        let (serial, reason) = (escaped(&part.serial), escaped(&part.reason()));
        let properties = [("time", part.time.as_deref().unwrap_or_default()), ("judged", &part.judged)];
        // Writing into a string does not fail.
        let took = part.seconds.map_or_else(String::new, |seconds| format!(" time=\"{seconds:.3}\""));
        let _ = writeln!(text, "    <testcase classname=\"{source}\" name=\"{serial}\"{took}>");
        let _ = writeln!(text, "      <properties>");
        for (name, value) in properties {
            let _ = writeln!(text, "        <property name=\"{name}\" value=\"{}\"/>", escaped(value));
        }
        let _ = writeln!(text, "      </properties>");
        let _ = match part.verdict {
            Verdict::Go => Ok(()),
            Verdict::NoGo => writeln!(text, "      <failure message=\"{reason}\"/>"),
            Verdict::CannotJudge => writeln!(text, "      <error message=\"{reason}\"/>"),
        };
        let _ = writeln!(text, "    </testcase>");
    }
    text.push_str("  </testsuite>\n</testsuites>\n");
    text
}

/// Escapes text for an attribute of XML, which cannot hold control characters.
fn escaped(text: &str) -> String {
    let mut escaped = String::new();
    for c in plain(text).chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            // No characters of XML.
            '\u{fffe}' | '\u{ffff}' => escaped.push('\u{fffd}'),
            other => escaped.push(other),
        }
    }
    escaped
}

/// A time as RFC 3339, UTC, in milliseconds.
pub(crate) fn utc(time: SystemTime) -> String {
    let since = time.duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO);
    let (seconds, millis) = (since.as_secs(), since.subsec_millis());
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    // Eras of 400 years begin on March 1st, so that the leap day is the last of its year.
    let day = days + 719_468;
    let (era, day) = (day / 146_097, day % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let (date, month) = (day - (153 * month + 2) / 5 + 1, if month < 10 { month + 3 } else { month - 9 });
    let year = 400 * era + year + u64::from(month < 3);
    let (hour, minute, second) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year:04}-{month:02}-{date:02}T{hour:02}:{minute:02}:{second:02}.{millis:03}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(serial: &str, verdict: Verdict, seconds: f64) -> PartVerdict {
        let reasons = if verdict == Verdict::Go { Vec::new() } else { vec!["by <+2> \"px²\"".to_string()] };
        let time = Some("2026-01-02T03:04:05.000Z".to_string());
        PartVerdict {
            serial: serial.to_string(),
            time,
            judged: String::new(),
            verdict,
            reasons,
            seconds: Some(seconds),
        }
    }

    #[test]
    fn times_are_utc() {
        for (seconds, text) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_399, "2000-02-28T23:59:59.000Z"),
            (951_782_400, "2000-02-29T00:00:00.000Z"),
            (1_795_681_857, "2026-11-26T08:30:57.000Z"),
            (4_107_542_399, "2100-02-28T23:59:59.000Z"),
            (4_107_542_400, "2100-03-01T00:00:00.000Z"),
        ] {
            assert_eq!(utc(UNIX_EPOCH + Duration::from_secs(seconds)), text);
        }
    }

    #[test]
    fn quantiles_are_those_of_parts() {
        let parts: Vec<_> = (1..=200).map(|n| part("a", Verdict::Go, f64::from(n))).collect();
        let counts = VerdictCounts::of(parts.iter());
        assert_eq!((counts.seconds_p50, counts.seconds_p99), (Some(100.0), Some(198.0)));
        assert_eq!(VerdictCounts::of(parts[..1].iter()).seconds_p99, Some(1.0));
        assert_eq!(VerdictCounts::of(parts[..0].iter()).seconds_p50, None);
        let kept = [PartVerdict { seconds: None, ..part("a", Verdict::Go, 0.0) }];
        assert_eq!(VerdictCounts::of(kept.iter()).line(), "1 go, 0 no-go, 0 cannot judge");
        assert!(junit("in", kept.iter()).contains("name=\"a\">"));
    }

    #[test]
    fn the_worst_verdict_is_the_status() {
        let status = |verdicts: &[Verdict]| {
            let parts: Vec<_> = verdicts.iter().map(|verdict| part("a", *verdict, 1.0)).collect();
            VerdictCounts::of(parts.iter()).check()
        };
        assert_eq!(status(&[Verdict::Go, Verdict::CannotJudge, Verdict::NoGo]), Err(Failure::NoGo));
        assert_eq!(status(&[Verdict::Go, Verdict::CannotJudge]), Err(Failure::CannotJudge));
        assert_eq!((status(&[Verdict::Go]), status(&[])), (Ok(()), Ok(())));
    }

    #[test]
    fn names_from_outside_are_escaped() {
        let parts = [part("a<b>&\"\n\u{1}", Verdict::NoGo, 0.5), part("b", Verdict::CannotJudge, 0.5)];
        let text = junit("in & out", parts.iter());
        assert!(text.contains(r#"tests="2" failures="1" errors="1" skipped="0" time="1.000""#), "{text}");
        assert!(
            text.contains(r#"classname="in &amp; out" name="a&lt;b&gt;&amp;&quot;\n\u{1}" time="0.500""#),
            "{text}"
        );
        assert!(text.contains(r#"<failure message="by &lt;+2&gt; &quot;px²&quot;"/>"#), "{text}");
        let table = csv(parts.iter().map(|part| (part, "out/a,b"))).unwrap();
        let table = String::from_utf8(table).unwrap();
        assert!(table.starts_with("serial,time,judged,verdict,seconds,reasons,output\n"), "{table}");
        let quoted = r#""by <+2> ""px²""","out/a,b""#;
        assert!(table.contains(quoted), "{table}");
    }
}
