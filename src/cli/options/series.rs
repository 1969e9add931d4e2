//! The series of photographs in a folder, by their names.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The fewest photographs of a series. Two are a pair.
const FEWEST: usize = 3;

/// Digits of a fraction that are compared.
const FRACTION_DIGITS: usize = 9;

/// Returns each series of three or more photographs in the order of its numbers.
///
/// The names of a series differ in their numbers only: `IMG_0001.JPG`, `frame-1.png`, `0.5mm.tif`. A single letter at
/// the end of a name counts like a number: `a.png`. Case does not matter.
pub(crate) fn find(files: &[PathBuf]) -> Vec<Vec<PathBuf>> {
    let mut groups: BTreeMap<Vec<String>, Vec<Named>> = BTreeMap::new();
    for file in files {
        let (texts, numbers) = split(file);
        if !numbers.is_empty() {
            groups.entry(texts).or_default().push(Named { numbers, file: file.clone() });
        }
    }
    join_signed(&mut groups);
    join_first(&mut groups, files);
    let mut found: Vec<_> = groups.into_values().flat_map(|group| apart(ordered(group))).collect();
    found.retain(|series| series.len() >= FEWEST);
    found.into_iter().map(|series| series.into_iter().map(|named| named.file).collect()).collect()
}

/// The order of times, if it is another than the given one and its reverse. Equal times, as of a burst, leave it open.
pub(crate) fn by_time(times: &[&str]) -> Option<Vec<usize>> {
    let mut order: Vec<usize> = (0..times.len()).collect();
    order.sort_by_key(|n| times[*n]);
    let is_distinct = order.windows(2).all(|pair| times[pair[0]] != times[pair[1]]);
    (is_distinct && !times.is_sorted() && !times.iter().rev().is_sorted()).then_some(order)
}

/// Whether frames begin with the last position: the positions are, in some unit, their numbers with the dash before them
/// as a minus sign, from the last frame to the first.
pub(crate) fn is_backwards(frames: &[PathBuf], positions: &[f64]) -> bool {
    let unit = |(file, at): (&PathBuf, &f64)| {
        let stem = stem(file).replace(',', ".");
        let number: f64 = stem.rsplit_once('-')?.1.trim_end_matches(char::is_alphabetic).parse().ok()?;
        Some(-at / number).filter(|unit| *unit > 0.0)
    };
    let units: Option<Vec<f64>> = frames.iter().rev().zip(positions).map(unit).collect();
    units.is_some_and(|units| units.iter().all(|unit| (unit / units[0] - 1.0).abs() < 1e-6))
}

/// The first and the last name of a series, for messages.
pub(crate) fn ends(frames: &[PathBuf]) -> String {
    let [first, last] = [frames.first(), frames.last()].map(|file| file.map_or(String::new(), |file| file_name(file)));
    format!("{first} to {last}")
}

/// A photograph, and the numbers in its name.
#[derive(Clone, Debug)]
struct Named {
    numbers: Vec<Number>,
    file: PathBuf,
}

/// A number in a name, as written.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Number {
    whole: i128,
    /// The digits after a point or a comma.
    fraction: String,
    is_negative: bool,
    /// Whether a plus is before it.
    has_plus: bool,
}

impl Number {
    fn is_zero(&self) -> bool {
        self.whole == 0 && self.fraction.bytes().all(|digit| digit == b'0')
    }

    /// A key that orders numbers. `is_count`: the fraction is a number of its own, so that 1.10 follows 1.9.
    fn key(&self, is_count: bool) -> i128 {
        let digits: String = self.fraction.chars().take(FRACTION_DIGITS).collect();
        let padded = if is_count { digits } else { format!("{digits:0<FRACTION_DIGITS$}") };
        let value = self.whole * 10i128.pow(FRACTION_DIGITS as u32) + padded.parse::<i128>().unwrap_or(0);
        if self.is_negative { -value } else { value }
    }
}

/// Splits a name into the texts around its numbers, and the numbers.
fn split(file: &Path) -> (Vec<String>, Vec<Number>) {
    let stem = stem(file).to_lowercase();
    let extension = file.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let (mut texts, mut numbers, mut rest) = (Vec::new(), Vec::new(), stem.as_str());
    while let Some(at) = rest.find(|c: char| c.is_ascii_digit()) {
        texts.push(rest[..at].to_string());
        let (whole, after) = digits(&rest[at..]);
        let (fraction, after) = match after.strip_prefix(['.', ',']).map(digits) {
            Some((fraction, after)) if !fraction.is_empty() => (fraction, after),
            _ => ("", after),
        };
        // A number of more than 18 digits is a date or a hash. Its last 18 digits are used.
        let whole = whole[whole.len().saturating_sub(18)..].parse().unwrap_or(0);
        numbers.push(Number { whole, fraction: fraction.to_string(), ..Number::default() });
        rest = after;
    }
    let mut tail = rest.chars().rev();
    let letter =
        tail.next().filter(char::is_ascii_alphabetic).filter(|_| !tail.next().is_some_and(char::is_alphabetic));
    match letter {
        Some(letter) => {
            numbers.push(Number { whole: i128::from(u32::from(letter)), ..Number::default() });
            // The mark keeps letters apart from numbers.
            texts.extend([rest[..rest.len() - 1].to_string(), format!("\0.{extension}")]);
        }
        None => texts.push(format!("{rest}.{extension}")),
    }
    (texts, numbers)
}

/// Splits a text after its leading digits.
fn digits(text: &str) -> (&str, &str) {
    text.split_at(text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len()))
}

/// Reads a dash before a number as a minus sign if the same names have a plus in its place, or without it include the
/// number 0: `z-5`, `z0`, `z5`. Elsewhere it is a hyphen, as in `frame-1`.
fn join_signed(groups: &mut BTreeMap<Vec<String>, Vec<Named>>) {
    for sign in ['+', '-'] {
        for key in groups.keys().cloned().collect::<Vec<_>>() {
            for n in 0..key.len() - 1 {
                let Some(text) = key[n].strip_suffix(sign) else { continue };
                let mut unsigned = key.clone();
                unsigned[n] = text.to_string();
                let is_sign = |named: &Named| named.numbers[n].is_zero() || named.numbers[n].has_plus;
                if sign == '-' && !groups.get(&unsigned).is_some_and(|group| group.iter().any(is_sign)) {
                    continue;
                }
                let Some(mut group) = groups.remove(&key) else { continue };
                let numbers = group.iter_mut().map(|named| &mut named.numbers[n]);
                numbers.for_each(|number| (number.has_plus, number.is_negative) = (sign == '+', sign == '-'));
                groups.entry(unsigned).or_default().extend(group);
                break;
            }
        }
    }
}

/// Adds the first of files that a system numbered because their names were equal: `scan.png` to `scan (1).png`.
fn join_first(groups: &mut BTreeMap<Vec<String>, Vec<Named>>, files: &[PathBuf]) {
    let is_copied = |key: &[String]| key.last().is_some_and(|after| after.starts_with(")."));
    for (_, group) in groups.iter_mut().filter(|(key, _)| is_copied(key)) {
        let Named { mut numbers, file } = group[0].clone();
        let (stem, extension) = (stem(&file), file.extension().unwrap_or_default().to_string_lossy());
        let first =
            stem.rsplit_once('(').map(|(before, _)| format!("{}.{extension}", before.trim_end()).to_lowercase());
        let file = files.iter().find(|file| first.as_ref() == Some(&file_name(file).to_lowercase()));
        numbers.pop();
        numbers.push(Number::default());
        group.extend(file.cloned().map(|file| Named { numbers, file }));
    }
}

/// Orders photographs by their numbers.
fn ordered(mut group: Vec<Named>) -> Vec<Named> {
    let is_count: Vec<bool> = (0..group[0].numbers.len()).map(|n| is_count(&group, n)).collect();
    group.sort_by_cached_key(|named| {
        named.numbers.iter().zip(&is_count).map(|(number, is_count)| number.key(*is_count)).collect::<Vec<_>>()
    });
    group
}

/// Whether the fractions of number `n` are numbers of their own, as in `1.9, 1.10`. A decimal is rarely padded with a
/// zero to more digits than another one: two would be equal, or one of a single range would end in 0.
fn is_count(group: &[Named], n: usize) -> bool {
    let distinct =
        |key: &dyn Fn(&Number) -> i128| group.iter().map(|named| key(&named.numbers[n])).collect::<BTreeSet<_>>().len();
    let shortest = group.iter().map(|named| named.numbers[n].fraction.len()).min().unwrap_or(0);
    let is_padded =
        |named: &Named| named.numbers[n].fraction.len() > shortest && named.numbers[n].fraction.ends_with('0');
    distinct(&|number| number.key(false)) < distinct(&|number| number.key(true))
        || distinct(&|number| number.whole) == 1 && group.iter().any(is_padded)
}

/// Splits photographs with several numbers into series: if one number counts within several values of the others, and
/// begins again in each, or if each value of one number occurs with each of the others: `s1_f1, s1_f2, s2_f1, s2_f2`.
/// Where it does not begin again, as in times of day, the photographs are one series.
fn apart(group: Vec<Named>) -> Vec<Vec<Named>> {
    // Without number `n`, by the values of the others.
    let without = |n: usize| {
        let mut parts: BTreeMap<Vec<Number>, Vec<Named>> = BTreeMap::new();
        for named in &group {
            let mut others = named.numbers.clone();
            others.remove(n);
            parts.entry(others).or_default().push(named.clone());
        }
        parts
    };
    let all: Vec<_> = (0..group[0].numbers.len()).map(without).collect();
    for (n, parts) in all.iter().enumerate() {
        let long: Vec<&Vec<Named>> = parts.values().filter(|part| part.len() >= FEWEST).collect();
        let mut seen = BTreeSet::new();
        let begins_again = long.iter().flat_map(|part| part.iter()).any(|named| !seen.insert(&named.numbers[n]));
        if long.len() > 1 && begins_again {
            return parts.values().cloned().collect();
        }
    }
    for (n, parts) in all.iter().enumerate() {
        let values = |part: &Vec<Named>| part.iter().map(|named| named.numbers[n].clone()).collect::<BTreeSet<_>>();
        let mut each = parts.values().map(values);
        let first = each.next().filter(|first| first.len() > 1 && parts.len() > 1);
        if first.is_some_and(|first| each.all(|part| part == first)) {
            return parts.values().cloned().collect();
        }
    }
    vec![group]
}

/// The name of a file without its folders.
pub(crate) fn file_name(file: &Path) -> String {
    file.file_name().unwrap_or(file.as_os_str()).to_string_lossy().into_owned()
}

/// The name of a file without folders and extension.
pub(crate) fn stem(file: &Path) -> String {
    file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(names: &[&str]) -> Vec<Vec<String>> {
        let files: Vec<PathBuf> = names.iter().map(PathBuf::from).collect();
        find(&files).iter().map(|series| series.iter().map(|file| file_name(file)).collect()).collect()
    }

    #[test]
    fn names_with_a_number_that_counts_are_a_series_in_its_order() {
        for names in [
            &["IMG_0001.JPG", "IMG_0002.JPG", "IMG_0003.jpg", "img_0010.JPG"][..],
            &["frame-1.png", "frame-2.png", "frame-9.png", "frame-10.png", "frame-12.png"],
            &["0.25mm.tif", "0.5mm.tif", "0.75mm.tif", "1mm.tif", "1.25mm.tif", "10mm.tif"],
            &["0,5mm.tif", "1,0mm.tif", "1,5mm.tif"],
            &["s_1.1.png", "s_1.2.png", "s_1.9.png", "s_1.10.png", "s_1.11.png"],
            &["t1.8.png", "t1.9.png", "t1.10.png"],
            &["z-10.tif", "z-5.tif", "z0.tif", "z5.tif"],
            &["a.png", "b.png", "c.png"],
            &["part_a.png", "part_b.png", "part_C.png"],
            &["20240501_120001.jpg", "20240501_120003.jpg", "20240501_120103.jpg"],
            &["2024-05-01 12.00.58.jpg", "2024-05-01 12.01.01.jpg", "2024-05-01 12.01.04.jpg"],
            &["01_5.0mm.png", "02_5.5mm.png", "03_6.0mm.png"],
            &["1.png", "2.png", "3.png"],
            &["IMG_1 (1).png", "IMG_1 (2).png", "IMG_1 (3).png"],
            &["z-30.tif", "z-5.tif", "z+000.tif", "z+5.tif", "z+30.tif"],
            &["z-1.5.tif", "z-0.5.tif", "z+0.5.tif", "z+1.5.tif"],
            &["scan.png", "scan (1).png", "scan (2).png", "scan (10).png"],
            &["stack.0001.ome.tif", "stack.0002.ome.tif", "stack.0003.ome.tif"],
        ] {
            let mut shuffled = names.to_vec();
            shuffled.rotate_left(2);
            shuffled.swap(0, 1);
            assert_eq!(found(&shuffled), [names]);
        }
    }

    #[test]
    fn times_order_frames_unless_they_agree_with_the_names() {
        assert_eq!([&["1", "2", "2", "3"][..], &["3", "2", "1"], &["2", "1", "2"]].map(by_time), [const { None }; 3]);
        assert_eq!(by_time(&["3", "4", "1", "2"]), Some(vec![2, 3, 0, 1]));
    }

    #[test]
    fn negative_positions_show_that_a_dash_is_a_minus_sign() {
        let frames = ["z-1.png", "z-2.png", "z-3.png"].map(PathBuf::from);
        let is_backwards = |positions: [f64; 3]| is_backwards(&frames, &positions);
        assert!(is_backwards([-3.0, -2.0, -1.0]) && is_backwards([-0.3, -0.2, -0.1]));
        assert!(
            ![[-1.0, -2.0, -3.0], [1.0, 2.0, 3.0], [3.0, 2.0, 1.0], [-6.0, -5.0, -4.0]]
                .map(is_backwards)
                .contains(&true)
        );
    }

    #[test]
    fn other_photographs_belong_to_no_series() {
        let stray = ["mask.png", "expected.jpg", "f_1_preview.png", "f_1.jpg", "truth.exr", "f.png"];
        let files = [&["f_1.png", "f_2.png", "f_10.png"][..], &stray].concat();
        assert_eq!(found(&files), [["f_1.png", "f_2.png", "f_10.png"]]);
        let two = found(&["a_1.png", "a_2.png", "a_3.png", "b_1.png", "b_2.png", "b_3.png", "b_4.png"]);
        assert_eq!(two.iter().map(Vec::len).collect::<Vec<_>>(), [3, 4]);
        let scans: Vec<String> = (0..8).map(|n| format!("scan{}_{:03}.png", n / 4, n % 4)).collect();
        let scans = found(&scans.iter().map(String::as_str).collect::<Vec<_>>());
        assert_eq!(scans.iter().map(Vec::len).collect::<Vec<_>>(), [4, 4]);
        let both = found(&["1.jpg", "1.tif", "2.jpg", "2.tif", "3.jpg", "3.tif"]);
        assert_eq!(both, [["1.jpg", "2.jpg", "3.jpg"], ["1.tif", "2.tif", "3.tif"]]);
        let wide = found(&["s1_f1.png", "s2_f1.png", "s3_f1.png", "s1_f2.png", "s2_f2.png", "s3_f2.png"]);
        assert_eq!(wide.iter().map(Vec::len).collect::<Vec<_>>(), [3, 3]);
        for none in [
            &["near.png", "middle.png", "far.png"][..],
            &["a_1.png", "a_2.png"],
            &["3f2a.png", "b81e.png", "0c.png"],
            &["s1_f1.png", "s1_f2.png", "s2_f1.png", "s2_f2.png"],
        ] {
            assert_eq!(found(none), Vec::<Vec<String>>::new());
        }
    }
}
