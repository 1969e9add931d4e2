//! What a file says of its values: that they follow the sRGB curve, that they are linear, or something else.

use std::io::Cursor;

/// Values follow the sRGB curve.
pub(super) const SRGB: &str = "sRGB";
/// Values are proportional to light.
pub(super) const LINEAR: &str = "linear";

/// By the chunks of a PNG: sRGB, or gAMA.
pub(super) fn of_png(bytes: &[u8]) -> Option<String> {
    let reader = png::Decoder::new(Cursor::new(bytes)).read_info().ok()?;
    let info = reader.info();
    if info.srgb.is_some() {
        return Some(SRGB.to_string());
    }
    match info.gama_chunk?.into_value() {
        exponent if exponent <= 0.0 => None,
        exponent if (exponent - 1.0).abs() < 1e-3 => Some(LINEAR.to_string()),
        exponent => Some(format!("gamma {:.2}", 1.0 / exponent)),
    }
}

/// By the name of an ICC profile.
pub(super) fn of_icc(profile: &[u8]) -> Option<String> {
    let name = description(profile)?;
    let lower = name.to_lowercase();
    if lower.contains("linear") {
        Some(LINEAR.to_string())
    } else if lower.contains("srgb") {
        Some(SRGB.to_string())
    } else {
        Some(name)
    }
}

/// The description of a profile: ICC.1:2022, 7.3 and 10.15; of version 2, ICC.1:2001-04, 6.5.17.
fn description(profile: &[u8]) -> Option<String> {
    let word = |at: usize| Some(u32::from_be_bytes(profile.get(at..at.checked_add(4)?)?.try_into().ok()?) as usize);
    let tags = word(128)?.min(1000);
    let entry = (0..tags).map(|i| 132 + 12 * i).find(|&at| profile.get(at..at + 4) == Some(b"desc"))?;
    let tag = profile.get(word(entry + 4)?..)?;
    let word = |at: usize| Some(u32::from_be_bytes(tag.get(at..at + 4)?.try_into().ok()?) as usize);
    let text = match tag.get(..4)? {
        b"desc" => String::from_utf8_lossy(tag.get(12..)?.get(..word(8)?)?).into_owned(),
        b"mluc" => {
            let bytes = tag.get(word(24)?..)?.get(..word(20)?)?;
            let units: Vec<u16> = bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
            String::from_utf16_lossy(&units)
        }
        _ => return None,
    };
    let text: String = text.chars().filter(|c| !c.is_control()).collect();
    (!text.trim().is_empty()).then(|| text.trim().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A profile with nothing but a description, of version 2 or 4.
    fn profile(name: &str, version: u8) -> Vec<u8> {
        let mut bytes = vec![0; 128];
        bytes.extend(1u32.to_be_bytes());
        bytes.extend(b"desc");
        bytes.extend(144u32.to_be_bytes());
        let tag = if version == 2 {
            [b"desc\0\0\0\0", &(name.len() as u32 + 1).to_be_bytes()[..], name.as_bytes(), b"\0"].concat()
        } else {
            let text: Vec<u8> = name.encode_utf16().flat_map(u16::to_be_bytes).collect();
            let head = [1, 12, 0x656e_5553, text.len() as u32, 28].map(u32::to_be_bytes).concat();
            [b"mluc\0\0\0\0", head.as_slice(), &text].concat()
        };
        bytes.extend((tag.len() as u32).to_be_bytes());
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
            let whole = profile("sRGB", version);
            (0..whole.len()).for_each(|length| assert!(of_icc(&whole[..length]).is_none_or(|name| name.len() < 5)));
        }
        assert_eq!(of_icc(&[0xff; 300]), None);
    }
}
