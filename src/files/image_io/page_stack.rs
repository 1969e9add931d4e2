//! The pages of a TIFF that are a focus sweep: those of one channel and one time of ImageJ and OME-TIFF, or all.

use std::path::{Path, PathBuf};

use super::photograph::Photograph;
use super::source::split_page;
use super::tiff_page::MAX_PAGES;
use crate::base::Error;

/// The frames of a focus sweep in a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PageStack {
    /// The pages in the order of z, as `FILE#N`.
    pub frames: Vec<PathBuf>,
    /// Number of pages that are left out because their size or format is not that of the first.
    pub left_out: usize,
    /// Numbers of channels and of times in the file.
    pub counts: [usize; 2],
    /// Size of a pixel on the object, µm, if it is stated.
    pub pixel_um: Option<f64>,
    /// Positions of the frames along z, µm, if they are stated.
    pub z_um: Option<Vec<f64>>,
}

/// The planes of a file, and where each is.
#[derive(Debug, Default, PartialEq)]
struct Planes {
    /// Numbers of z, channels and times.
    counts: [usize; 3],
    /// Of each plane, z fastest, then channels: the file, if it is another one, and the page from 1.
    pages: Vec<Option<(Option<String>, usize)>>,
    pixel_um: Option<f64>,
    step_um: Option<f64>,
    /// Stated z of planes, in the order of `pages`, µm.
    z_um: Vec<Option<f64>>,
}

impl PageStack {
    /// Reads the stack of a file; `None` for a file of fewer than three pages, and for one that is no TIFF. Channel and
    /// time are counted from 1; by default they are the first.
    ///
    /// # Errors
    /// [`Error::File`], also for a channel or a time that the file does not have.
    pub fn read(file: &Path, [channel, time]: [Option<usize>; 2]) -> Result<Option<Self>, Error> {
        let photograph = Photograph::open(file)?;
        let (pages, (description, resolution)) = (photograph.pages(), photograph.description());
        let is_page = split_page(file).1.is_some();
        let described =
            description.and_then(|text| Planes::of_ome(&text).or_else(|| Planes::of_imagej(&text, resolution)));
        let described = described.filter(|planes| planes.fits(pages));
        let is_described = described.is_some();
        let planes = described.unwrap_or_else(|| Planes::all(pages));
        let [depth, channels, times] = planes.counts;
        if is_page || depth * channels * times < 3 {
            return Ok(None);
        }
        // A sweep is at times stored as a series of times.
        let along_time = depth < 3 && times >= 3 && time.is_none();
        for (what, chosen, count) in [("channel", channel, channels), ("time", time, times)] {
            if chosen.is_some_and(|n| n > count) {
                let n = chosen.unwrap_or_default();
                return Err(Error::file(file, format!("has no {what} {n}; it has {count}")));
            }
        }
        let [channel, time] = [channel, time].map(|n| n.unwrap_or(1) - 1);
        let places = (0..if along_time { times } else { depth }).map(|n| {
            let (z, time) = if along_time { (0, n) } else { (n, time) };
            z + depth * (channel + channels * time)
        });
        let places: Vec<usize> = places.collect();
        let page = |place: &usize| {
            let (other, page) = planes.pages.get(*place)?.as_ref()?;
            let file = other.as_ref().map_or_else(|| file.to_path_buf(), |other| file.with_file_name(other));
            let mut name = file.into_os_string();
            name.push(format!("#{page}"));
            Some(PathBuf::from(name))
        };
        let Some(frames) = places.iter().map(page).collect::<Option<Vec<_>>>() else {
            return Err(Error::file(file, "lacks planes that its description lists; export it again"));
        };
        // Without a description a page may be a preview or a label.
        let all = frames.len();
        let kind = |page: &Photograph| (page.size(), page.format());
        let is_alike = |page: &PathBuf| photograph.clone().open_next(page).is_ok_and(|p| kind(&p) == kind(&photograph));
        let frames: Vec<PathBuf> = frames.into_iter().filter(|page| is_described || is_alike(page)).collect();
        if frames.len() < 3 {
            return Ok(None);
        }
        let stated = places.iter().map(|place| planes.z_um.get(*place).copied().flatten()).collect::<Option<Vec<_>>>();
        let rises = |z: &Vec<f64>| z.is_sorted_by(|a, b| a < b) || z.is_sorted_by(|a, b| a > b);
        let even =
            || Some(planes.step_um.filter(|_| !along_time)?).map(|step| (0..depth).map(|n| n as f64 * step).collect());
        Ok(Some(Self {
            left_out: all - frames.len(),
            frames,
            counts: [channels, if along_time { 1 } else { times }],
            pixel_um: planes.pixel_um,
            z_um: stated.filter(rises).or_else(even),
        }))
    }
}

impl Planes {
    /// All pages of a file without a description, as z.
    fn all(pages: usize) -> Self {
        let all = (1..=pages).map(|page| Some((None, page))).collect();
        Self { counts: [pages, 1, 1], pages: all, ..Self::default() }
    }

    /// Whether a file with this number of pages has the planes that are in it.
    fn fits(&self, pages: usize) -> bool {
        self.pages.iter().flatten().all(|(other, page)| other.is_some() || *page <= pages)
    }

    /// The place of a plane in the list.
    fn place(&self, [z, c, t]: [usize; 3]) -> Option<usize> {
        let [depth, channels, times] = self.counts;
        (z < depth && c < channels && t < times).then_some(z + depth * (c + channels * t))
    }

    /// No planes yet of these counts; `None` for more than a file can have.
    fn of_counts(counts: [usize; 3]) -> Option<Self> {
        let count = counts.iter().try_fold(1usize, |all, n| all.checked_mul((*n).max(1)))?;
        let empty = || Self { counts: counts.map(|n| n.max(1)), pages: vec![None; count], ..Self::default() };
        (count <= MAX_PAGES).then(empty)
    }

    /// Reads the description of ImageJ, lines of `key=value`. Channels are fastest, then z.
    fn of_imagej(text: &str, resolution: Option<f64>) -> Option<Self> {
        let value = |key: &str| text.lines().find_map(|line| line.trim().strip_prefix(key)?.strip_prefix('='));
        let count = |key: &str| value(key).and_then(|n| n.trim().parse::<usize>().ok());
        value("ImageJ")?;
        let images = count("images").unwrap_or(1);
        let [channels, slices, frames] = ["channels", "slices", "frames"].map(count);
        let (channels, times) = (channels.unwrap_or(1), frames.unwrap_or(1));
        let depth = slices.unwrap_or(images / channels.saturating_mul(times).max(1));
        let mut planes = Self::of_counts([depth, channels, times])?;
        for n in 0..planes.pages.len() {
            let [channels, depth] = [planes.counts[1], planes.counts[0]];
            let place = planes.place([n / channels % depth, n % channels, n / channels / depth])?;
            planes.pages[place] = Some((None, n + 1));
        }
        let unit = value("unit").and_then(micrometres);
        planes.step_um = value("spacing").and_then(|n| n.trim().parse().ok()).and_then(|n: f64| positive(n * unit?));
        planes.pixel_um = unit.zip(resolution).and_then(|(unit, resolution)| positive(unit / resolution));
        Some(planes)
    }

    /// Reads the description of OME-TIFF, of its first image.
    fn of_ome(text: &str) -> Option<Self> {
        let mut elements = Elements(text);
        elements.find(|(name, _)| *name == "OME")?;
        let (_, pixels) = elements.find(|(name, _)| *name == "Pixels")?;
        let count = |key: &str| Some(attribute(pixels, key)?.parse::<usize>().ok()?.max(1));
        let [depth, channels, times] = [count("SizeZ")?, count("SizeC")?, count("SizeT")?];
        let inner: Vec<_> = elements.take_while(|(name, _)| *name != "/Pixels").collect();
        // Samples of one page, such as red, green and blue, count as channels there.
        let of = |wanted: &'static str| inner.iter().filter(move |(name, _)| *name == wanted).map(|(_, all)| *all);
        let number = |attributes: &str, key: &str| attribute(attributes, key)?.parse::<usize>().ok();
        let samples = of("Channel").find_map(|all| number(all, "SamplesPerPixel")).unwrap_or(1).max(1);
        let mut planes = Self::of_counts([depth, channels.div_ceil(samples), times])?;
        let order: Vec<usize> =
            attribute(pixels, "DimensionOrder")?.chars().filter_map(|axis| "ZCT".find(axis)).collect();
        let [first, second, third] = <[usize; 3]>::try_from(order).ok()?;
        let counts = planes.counts;
        let mut files = inner.iter().peekable();
        while let Some((name, all)) = files.next() {
            if *name != "TiffData" {
                continue;
            }
            let uuid = files.peek().filter(|(name, _)| *name == "UUID");
            let file = uuid.and_then(|(_, all)| attribute(all, "FileName"));
            let start = ["FirstZ", "FirstC", "FirstT"].map(|key| number(all, key).unwrap_or(0).min(MAX_PAGES));
            let ifd = number(all, "IFD");
            let one_or_all = if ifd.is_some() { 1 } else { planes.pages.len() };
            let from = start[first] + counts[first] * (start[second] + counts[second] * start[third]);
            for n in 0..number(all, "PlaneCount").unwrap_or(one_or_all).min(planes.pages.len()) {
                let mut at = [0; 3];
                at[first] = (from + n) % counts[first];
                at[second] = (from + n) / counts[first] % counts[second];
                at[third] = (from + n) / counts[first] / counts[second];
                if let Some(place) = planes.place(at) {
                    planes.pages[place] = Some((file.clone(), ifd.unwrap_or(0).saturating_add(n + 1)));
                }
            }
        }
        let length = |all: &str, key: &str| {
            let unit = attribute(all, &format!("{key}Unit")).map_or(Some(1.0), |unit| micrometres(&unit))?;
            Some(attribute(all, key)?.parse::<f64>().ok()? * unit)
        };
        planes.pixel_um = length(pixels, "PhysicalSizeX").and_then(positive);
        planes.step_um = length(pixels, "PhysicalSizeZ").and_then(positive);
        planes.z_um = vec![None; planes.pages.len()];
        for all in of("Plane") {
            let at = ["TheZ", "TheC", "TheT"].map(|key| number(all, key).unwrap_or(usize::MAX));
            if let Some(place) = planes.place(at) {
                planes.z_um[place] = length(all, "PositionZ").filter(|z| z.is_finite());
            }
        }
        Some(planes)
    }
}

fn positive(value: f64) -> Option<f64> {
    (value.is_finite() && value > 0.0).then_some(value)
}

/// Micrometres of a unit of length; `None` for another word, such as pixel.
pub(super) fn micrometres(unit: &str) -> Option<f64> {
    Some(match unit.trim() {
        "nm" | "nanometer" => 1e-3,
        "µm" | "μm" | "um" | "micron" | "microns" | "micrometer" | r"\u00B5m" | "\u{fffd}m" => 1.0,
        "mm" | "millimeter" => 1e3,
        "cm" => 1e4,
        "m" | "meter" => 1e6,
        "inch" | "in" => 25_400.0,
        _ => return None,
    })
}

/// The elements of XML: the name without its prefix, and the attributes as written. An end has a slash before its name.
struct Elements<'a>(&'a str);

impl<'a> Iterator for Elements<'a> {
    type Item = (&'a str, &'a str);

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            self.0 = &self.0[self.0.find('<')? + 1..];
            if self.0.starts_with("!--") {
                self.0 = &self.0[self.0.find("-->")?..];
                continue;
            }
            let (inside, rest) = self.0.split_once('>')?;
            self.0 = rest;
            let (name, attributes) = inside.split_at(inside.find(char::is_whitespace).unwrap_or(inside.len()));
            let is_end = name.starts_with('/');
            let local = name.trim_matches('/').rsplit(':').next().unwrap_or_default();
            let name = if is_end && local == "Pixels" {
                "/Pixels"
            } else if is_end {
                ""
            } else {
                local
            };
            return Some((name, attributes));
        }
    }
}

/// The value of an attribute.
fn attribute(attributes: &str, key: &str) -> Option<String> {
    let mut rest = attributes;
    loop {
        let (name, after) = rest.split_once('=')?;
        let after = after.trim_start();
        let quote = after.chars().next().filter(|c| ['"', '\''].contains(c))?;
        let (value, behind) = after[1..].split_once(quote)?;
        if name.trim() == key {
            return Some(value.replace("&quot;", "\"").replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"));
        }
        rest = behind;
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tiff::encoder::{TiffEncoder, colortype};
    use tiff::tags::Tag;

    use super::*;
    use crate::base::Samples;

    /// Writes pages of 2x1 pixels that count from 1, the first with a description.
    fn save(file: &Path, pages: u8, description: &str) {
        let mut encoder = TiffEncoder::new(fs::File::create(file).unwrap()).unwrap();
        for page in 1..=pages {
            let mut image = encoder.new_image::<colortype::Gray8>(2, 1).unwrap();
            if page == 1 && !description.is_empty() {
                image.encoder().write_tag(Tag::ImageDescription, description).unwrap();
                image.encoder().write_tag(Tag::XResolution, tiff::encoder::Rational { n: 2, d: 1 }).unwrap();
            }
            image.write_data(&[page; 2]).unwrap();
        }
    }

    fn pages(stack: &PageStack) -> Vec<usize> {
        stack.frames.iter().map(|frame| split_page(frame).1.unwrap()).collect()
    }

    #[test]
    fn pages_of_a_channel_and_a_time_are_frames() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("z.tif");
        let read = |chosen| PageStack::read(&file, chosen).map(|stack| stack.map(|s| (pages(&s), s.pixel_um, s.z_um)));
        save(&file, 4, "");
        assert_eq!(read([None; 2]).unwrap(), Some((vec![1, 2, 3, 4], None, None)));
        let imagej =
            "ImageJ=1.53\nimages=12\nchannels=2\nslices=3\nframes=2\nhyperstack=true\nunit=micron\nspacing=0.5\n";
        save(&file, 12, imagej);
        let z = Some(vec![0.0, 0.5, 1.0]);
        assert_eq!(read([None; 2]).unwrap(), Some((vec![1, 3, 5], Some(0.5), z.clone())));
        assert_eq!(read([Some(2), Some(2)]).unwrap(), Some((vec![8, 10, 12], Some(0.5), z)));
        assert!(read([Some(3), None]).unwrap_err().to_string().contains("has no channel 3; it has 2"));
        // Steps in pixels are no lengths, and frames over time are a sweep if there is no z.
        save(&file, 3, "ImageJ=1.53\nimages=3\nframes=3\nunit=pixel\nspacing=1.0\n");
        assert_eq!(read([None; 2]).unwrap(), Some((vec![1, 2, 3], None, None)));
        save(&file, 2, "");
        assert_eq!(read([None; 2]).unwrap(), None);
        save(&file, 3, "ImageJ=1.53\nimages=3\nchannels=18446744073709551615\nframes=18446744073709551615\n");
        assert_eq!(read([None; 2]).unwrap().unwrap().0, [1, 2, 3]);
        // More planes than there are pages: the description is of another file.
        save(&file, 4, imagej);
        assert_eq!(read([None; 2]).unwrap().unwrap().0, [1, 2, 3, 4]);
    }

    #[test]
    fn ome_states_order_files_and_positions() {
        let ome = |pixels: &str, inner: &str| {
            format!(
                "<?xml version=\"1.0\"?><!-- <Pixels SizeZ='9'/> --><ome:OME xmlns:ome=\"x\"><Image><Pixels ID=\"Pixels:0\" \
                 SizeX=\"2\" SizeY=\"1\" {pixels} PhysicalSizeX=\"650\" PhysicalSizeXUnit=\"nm\" PhysicalSizeZ='2'>{inner}\
                 </Pixels></Image><Image><Pixels SizeZ=\"1\"/></Image></ome:OME>"
            )
        };
        let of = |pixels: &str, inner: &str| Planes::of_ome(&ome(pixels, inner)).unwrap();
        let page = |planes: &Planes, at| planes.pages[planes.place(at).unwrap()].clone();
        let all = of("DimensionOrder=\"XYCZT\" SizeZ=\"3\" SizeC=\"2\" SizeT=\"2\"", "<TiffData/>");
        assert_eq!((all.counts, all.pixel_um, all.step_um), ([3, 2, 2], Some(0.65), Some(2.0)));
        assert_eq!([page(&all, [2, 0, 0]), page(&all, [0, 1, 1])], [5, 8].map(|n| Some((None, n))));
        let inner = "<Channel SamplesPerPixel=\"3\"/><TiffData FirstT=\"18446744073709551615\"/><TiffData FirstZ=\"2\" IFD=\"0\"/><TiffData IFD=\"1\" PlaneCount=\"2\"/>\
                     <Plane TheZ=\"1\" TheC=\"0\" TheT=\"0\" PositionZ=\"0.003\" PositionZUnit=\"mm\"/>";
        let color = of("DimensionOrder=\"XYZCT\" SizeZ=\"3\" SizeC=\"3\" SizeT=\"1\"", inner);
        assert_eq!(color.counts, [3, 1, 1]);
        assert_eq!([0, 1, 2].map(|z| page(&color, [z, 0, 0])), [2, 3, 1].map(|n| Some((None, n))));
        assert_eq!(color.z_um, [None, Some(3.0), None]);
        let files = "<TiffData FirstZ=\"1\" IFD=\"0\"><UUID FileName=\"a &amp; b.tif\">urn:uuid:1</UUID></TiffData>";
        let split = of("DimensionOrder=\"XYZCT\" SizeZ=\"3\" SizeC=\"1\" SizeT=\"1\"", files);
        assert_eq!(split.pages, [None, Some((Some("a & b.tif".to_string()), 1)), None]);
        for bad in
            ["<OME><Pixels SizeZ=\"99999999999\" SizeC=\"1\" SizeT=\"1\" DimensionOrder=\"XYZCT\"/></OME>", "<OME", "<"]
        {
            assert_eq!(Planes::of_ome(bad), None);
        }
    }

    #[test]
    fn pages_under_one_directory_are_read() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("one.tif");
        save(&file, 1, "ImageJ=1.53\nimages=3\nslices=3\n");
        // The encoder writes the data before the directory, and ImageJ behind it.
        let entries: [(u16, u32); 8] =
            [(256, 2), (257, 1), (258, 8), (262, 1), (270, 0), (273, 144), (278, 1), (279, 2)];
        let mut bytes = [&b"MM\0*\0\0\0\x08"[..], &8u16.to_be_bytes()].concat();
        for (tag, value) in entries {
            let (kind, count, value) = if tag == 270 { (2u16, 33, 110) } else { (4, 1, value) };
            bytes.extend([&tag.to_be_bytes()[..], &kind.to_be_bytes()].concat());
            bytes.extend([u32::to_be_bytes(count), u32::to_be_bytes(value)].concat());
        }
        bytes.extend(0u32.to_be_bytes());
        bytes.extend(b"ImageJ=1.53\nimages=3\nslices=3\n\0\0\0\0");
        bytes.resize(144, 0);
        fs::write(&file, [&bytes[..], &[1, 2, 3, 4, 5, 6]].concat()).unwrap();
        let stack = PageStack::read(&file, [None; 2]).unwrap().unwrap();
        let frames = stack.frames.iter().map(|frame| crate::files::image_io::read(frame).unwrap().samples().clone());
        assert_eq!(frames.collect::<Vec<_>>(), [[1, 2], [3, 4], [5, 6]].map(|page| Samples::U8(page.to_vec())));
        // More than 4 GiB. The file is sparse: it takes little space on the disk.
        let side = 1u32 << 20;
        for at in [18, 102] {
            bytes[at..at + 4].copy_from_slice(&side.to_be_bytes());
        }
        bytes[110..110 + 26].copy_from_slice(b"ImageJ=1.53\nimages=4097\n\0\0");
        fs::write(&file, &bytes).unwrap();
        let sparse = fs::File::options().write(true).open(&file).unwrap();
        sparse.set_len(144 + 4097 * u64::from(side)).unwrap();
        let page = |n: usize| Photograph::open(&PathBuf::from(format!("{}#{n}", file.display())));
        let last = page(4097).unwrap();
        assert_eq!((last.pages(), last.size()), (4097, (side, 1)));
        assert!(page(4098).err().unwrap().to_string().contains("too long"));
    }
}
