//! What a file says of its values: that they follow the sRGB curve, that they are linear, or something else.

use std::io::Cursor;

use moxcms::{ColorProfile, ParsingOptions, ProfileText};

/// Values follow the sRGB curve.
pub(super) const SRGB: &str = "sRGB";
/// Values are proportional to light.
pub(super) const LINEAR: &str = "linear";
/// There is a profile, and nobody knows what it says.
pub(super) const UNREADABLE: &str = "those of an ICC profile that cannot be read";

/// The most bytes of an ICC profile that are looked into, 4 MiB: one with tables for a printer takes two.
pub(super) const MAX_PROFILE: usize = 4 << 20;

/// The most tags of a profile: real ones have two dozen, and a hostile one may name one large table over and over.
const MAX_TAGS: u32 = 100;

/// By the chunks of a PNG: sRGB, or gAMA, in which 1/2.2 is how writers before the chunk sRGB, and many since, state sRGB.
pub(super) fn of_png(bytes: &[u8]) -> Option<String> {
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), png::Limits { bytes: MAX_PROFILE });
    // Neither is asked for here, and both may unpack to more than the file is worth.
    decoder.set_ignore_iccp_chunk(true);
    decoder.set_ignore_text_chunk(true);
    let reader = decoder.read_info().ok()?;
    let info = reader.info();
    if info.srgb.is_some() {
        return Some(SRGB.to_string());
    }
    match info.gama_chunk?.into_value() {
        exponent if exponent <= 0.0 => None,
        exponent if (exponent - 1.0).abs() < 1e-3 => Some(LINEAR.to_string()),
        exponent if (exponent - 1.0 / 2.2).abs() < 1e-3 => Some(SRGB.to_string()),
        exponent => Some(format!("gamma {:.2}", 1.0 / exponent)),
    }
}

/// By the name of an ICC profile.
pub(super) fn of_icc(profile: &[u8]) -> Option<String> {
    let Some(profile) = parse(profile) else { return Some(UNREADABLE.to_string()) };
    let name = match profile.description? {
        ProfileText::PlainString(text) => text,
        ProfileText::Localizable(texts) => texts.into_iter().next()?.value,
        ProfileText::Description(text) => text.ascii_string,
    };
    let name: String = name.chars().filter(|c| !c.is_control()).collect();
    let (name, lower) = (name.trim(), name.to_lowercase());
    if name.is_empty() {
        None
    } else if lower.contains("linear") {
        Some(LINEAR.to_string())
    } else if lower.contains("srgb") {
        Some(SRGB.to_string())
    } else {
        Some(name.to_string())
    }
}

fn parse(profile: &[u8]) -> Option<ColorProfile> {
    let tags = u32::from_be_bytes(profile.get(128..132)?.try_into().ok()?);
    let options = ParsingOptions { max_profile_size: MAX_PROFILE, ..ParsingOptions::default() };
    (tags <= MAX_TAGS).then(|| ColorProfile::new_from_slice_with_options(profile, options).ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A profile with nothing but a description, of version 2 or 4.
    fn profile(name: &str, version: u8) -> Vec<u8> {
        let mut bytes = vec![0; 128];
        bytes[8] = version;
        for (at, word) in [(12, b"mntr"), (16, b"RGB "), (20, b"XYZ "), (36, b"acsp")] {
            bytes[at..at + 4].copy_from_slice(word);
        }
        let tag = if version == 2 {
            [b"desc\0\0\0\0", &(name.len() as u32 + 1).to_be_bytes()[..], name.as_bytes(), b"\0"].concat()
        } else {
            let text: Vec<u8> = name.encode_utf16().flat_map(u16::to_be_bytes).collect();
            let head = [1, 12, 0x656e_5553, text.len() as u32, 28].map(u32::to_be_bytes).concat();
            [b"mluc\0\0\0\0", head.as_slice(), &text].concat()
        };
        bytes.extend([1, u32::from_be_bytes(*b"desc"), 144, tag.len() as u32].map(u32::to_be_bytes).concat());
        bytes.extend(tag);
        bytes
    }

    #[test]
    fn a_profile_is_known_by_its_name() {
        for version in [2, 4] {
            for (name, expected) in
                [("sRGB IEC61966-2.1", "sRGB"), ("Linear Rec709", "linear"), ("Adobe RGB (1998)", "Adobe RGB (1998)")]
            {
                assert_eq!(of_icc(&profile(name, version)).as_deref(), Some(expected));
            }
            assert_eq!(of_icc(&profile(" ", version)), None);
        }
        for (whole, expected) in [(ColorProfile::new_srgb(), "sRGB"), (ColorProfile::new_display_p3(), "Display P3")] {
            assert_eq!(of_icc(&whole.encode().unwrap()).as_deref(), Some(expected));
        }
    }

    #[test]
    fn a_profile_that_cannot_be_read_says_so() {
        for whole in [profile("sRGB", 2), profile("sRGB", 4), ColorProfile::new_srgb().encode().unwrap()] {
            for at in 0..whole.len() {
                assert_ne!(of_icc(&whole[..at]).as_deref(), Some("sRGB"), "{at}");
                let mut bent = whole.clone();
                bent[at] ^= 0xa5;
                of_icc(&bent);
            }
        }
        let large = [profile("sRGB", 4), vec![0; MAX_PROFILE]].concat();
        for bad in [&[0xff; 300][..], &[], &large] {
            assert_eq!(of_icc(bad).as_deref(), Some(UNREADABLE));
        }
    }
}
