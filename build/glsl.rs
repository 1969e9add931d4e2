//! Reads the interface of a shader from its text: bindings, push constants, flags, structs and workgroup.
//!
//! It reads the declarations as the shaders of this project write them: each begins a line, a binding takes one line,
//! and a member of a block or a struct is declared on one line. Anything else is an error that names file and line.

use std::collections::BTreeMap;

/// A shader, or an include by itself.
#[derive(Debug, Default)]
pub(crate) struct Shader {
    /// By their numbers, from 0 on without a gap.
    pub(crate) bindings: Vec<Binding>,
    /// The members of the block of push constants.
    pub(crate) constants: Vec<Member>,
    /// The include that declares them; empty if it is the shader itself.
    pub(crate) constants_file: String,
    /// The boolean specialization constants.
    pub(crate) flags: Vec<Flag>,
    pub(crate) structs: BTreeMap<String, Struct>,
    /// Width and height of a workgroup.
    pub(crate) workgroup: Option<[u32; 2]>,
    /// Global constants that are literal integers.
    integers: BTreeMap<String, u32>,
}

/// A binding: `layout(binding = 0, r32f) uniform readonly image2DArray from;`.
#[derive(Debug, PartialEq)]
pub(crate) struct Binding {
    pub(crate) number: usize,
    /// The name of the image, or of the only member of the block.
    pub(crate) name: String,
    pub(crate) kind: Kind,
    pub(crate) reads: bool,
    pub(crate) writes: bool,
    /// The struct that the buffer holds.
    pub(crate) holds: Option<String>,
    pub(crate) doc: String,
}

/// The kind of a binding. `Words` is an image of words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    Image,
    Words,
    Buffer,
    Uniform,
}

/// A flag: `layout(constant_id = 2) const bool FIRST = false;`.
#[derive(Debug, PartialEq)]
pub(crate) struct Flag {
    pub(crate) id: u32,
    pub(crate) name: String,
    pub(crate) doc: String,
}

/// A struct, and the include that declares it.
#[derive(Debug)]
pub(crate) struct Struct {
    pub(crate) file: String,
    pub(crate) members: Vec<Member>,
}

/// A member of a block or a struct.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Member {
    pub(crate) name: String,
    pub(crate) kind: Scalar,
    /// The floats or words of a vector; 1 for a scalar.
    pub(crate) width: u32,
    /// The length of an array.
    pub(crate) count: Option<u32>,
    pub(crate) doc: String,
    /// File and line.
    place: String,
}

/// What a member consists of.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Scalar {
    Float,
    /// Of both signs. In Rust it is unsigned: sizes, places and counts are never negative.
    Int,
    Uint,
    Struct(String),
}

/// A line of a shader with its includes: file and number, code, and the comment behind it.
struct Line {
    place: String,
    file: String,
    code: String,
    comment: String,
}

impl Shader {
    /// Reads a file. `text` returns the text of a file by its path in `glsl/`.
    pub(crate) fn read(path: &str, text: &dyn Fn(&str) -> Result<String, String>) -> Result<Self, String> {
        let mut lines = Vec::new();
        collect(path, text, &mut lines)?;
        let mut shader = Self::default();
        let mut at = 0;
        while at < lines.len() {
            at += shader.declaration(&lines[at..]).map_err(|error| format!("{}: {error}", lines[at].place))?;
        }
        shader.bindings.sort_by_key(|binding| binding.number);
        for (n, binding) in shader.bindings.iter().enumerate() {
            if binding.number != n {
                return Err(format!("glsl/{path}: binding {n} is missing, or declared twice"));
            }
        }
        Ok(shader)
    }

    /// Reads the declaration that begins at the first line, if one does. Returns the number of its lines.
    fn declaration(&mut self, lines: &[Line]) -> Result<usize, String> {
        let Line { code, comment, file, .. } = &lines[0];
        if let Some(rest) = code.strip_prefix("const int ") {
            self.integers.extend(literals(rest).filter_map(|(name, value)| Some((name.into(), value.parse().ok()?))));
        } else if let Some(rest) = code.strip_prefix("struct ") {
            let name = rest.split(['{', ' ']).next().unwrap_or_default().to_string();
            let (members, count) = self.members(lines)?;
            self.structs.insert(name, Struct { file: file.clone(), members });
            return Ok(count);
        } else if let Some((layout, rest)) = code.strip_prefix("layout(").and_then(|rest| rest.split_once(')')) {
            if layout == "push_constant" {
                let (members, count) = self.members(lines)?;
                (self.constants, self.constants_file) = (members, file.clone());
                return Ok(count);
            }
            let layout: BTreeMap<&str, &str> =
                layout.split(',').filter_map(|part| part.split_once('=')).map(trimmed).collect();
            if let Some(number) = layout.get("binding") {
                self.bindings.push(binding(number.parse().map_err(|_| "no number of a binding")?, rest, comment)?);
            } else if let Some(id) = layout.get("constant_id") {
                let name = rest.trim().strip_prefix("const bool ").and_then(|rest| rest.strip_suffix(" = false;"));
                let name = name.ok_or("a specialization constant must be `const bool NAME = false;`")?.into();
                let id = id.parse().map_err(|_| "no number of a constant")?;
                self.flags.push(Flag { id, name, doc: comment.clone() });
            } else if layout.contains_key("local_size_x_id") {
                let side =
                    |name| layout.get(name).ok_or_else(|| format!("no {name}")).and_then(|side| self.integer(side));
                self.workgroup = Some([side("local_size_x")?, side("local_size_y")?]);
            }
        }
        Ok(1)
    }

    /// A literal or a constant.
    fn integer(&self, text: &str) -> Result<u32, String> {
        let literal = text.parse().ok().or_else(|| self.integers.get(text).copied());
        literal.ok_or_else(|| format!("`{text}` is neither a literal nor a constant that is one"))
    }

    /// The members between the braces from the first line on, and the number of lines.
    fn members(&self, lines: &[Line]) -> Result<(Vec<Member>, usize), String> {
        let (mut members, mut above) = (Vec::new(), String::new());
        for (n, line) in lines.iter().enumerate() {
            let code = line.code.split_once('{').map_or(line.code.as_str(), |(_, inside)| inside);
            let (code, ends) = code.split_once('}').map_or((code, false), |(inside, _)| (inside, true));
            let doc = if line.comment.is_empty() { std::mem::take(&mut above) } else { line.comment.clone() };
            if line.code.is_empty() {
                above = format!("{above} {}", line.comment).trim().into();
                continue;
            }
            let declared = code.split(';').map(str::trim).filter(|declared| !declared.is_empty());
            for declared in declared {
                let (kind, names) = declared.split_once(' ').ok_or_else(|| format!("{}: no member", line.place))?;
                let (kind, width) = scalar(kind);
                for name in names.split(',').map(str::trim) {
                    let (name, count) = match name.split_once('[') {
                        Some((name, count)) => (name, Some(self.integer(count.trim_end_matches(']'))?)),
                        None => (name, None),
                    };
                    let (name, place) = (name.into(), line.place.clone());
                    members.push(Member { name, kind: kind.clone(), width, count, doc: doc.clone(), place });
                }
            }
            if ends {
                return Ok((members, n + 1));
            }
        }
        Err("the block has no end".into())
    }

    /// The offsets in bytes of all scalars of these members, by the rules of std430, and the size.
    ///
    /// In Rust members follow each other without gaps, so a gap is an error.
    pub(crate) fn offsets(&self, members: &[Member]) -> Result<(Vec<u32>, u32), String> {
        let (mut offsets, mut at) = (Vec::new(), 0u32);
        for member in members {
            let alignment = self.alignment(member)?;
            if at % alignment != 0 {
                return Err(format!(
                    "{}: `{}` begins at a multiple of {alignment} bytes, but byte {at} is next: declare it earlier, or as an array",
                    member.place, member.name
                ));
            }
            let (element, size) = match &member.kind {
                Scalar::Struct(_) => self.offsets(self.inside(member)?)?,
                _ => ((0..member.width).map(|n| 4 * n).collect(), 4 * member.width),
            };
            if size % alignment != 0 {
                return Err(format!("{}: `{}` has a gap behind it", member.place, member.name));
            }
            for n in 0..member.count.unwrap_or(1) {
                offsets.extend(element.iter().map(|offset| at + n * size + offset));
            }
            at += member.count.unwrap_or(1) * size;
        }
        Ok((offsets, at))
    }

    /// The members of a member that is a struct; none of others.
    fn inside(&self, member: &Member) -> Result<&[Member], String> {
        let Scalar::Struct(name) = &member.kind else { return Ok(&[]) };
        let unknown = || format!("{}: the type `{name}` is not known", member.place);
        self.structs.get(name).map(|inside| inside.members.as_slice()).ok_or_else(unknown)
    }

    fn alignment(&self, member: &Member) -> Result<u32, String> {
        let own = [4, 8, 16, 16][member.width as usize - 1];
        self.inside(member)?.iter().try_fold(own, |most, inside| Ok(most.max(self.alignment(inside)?)))
    }
}

/// The names and values of `A = 1, B = 2;`.
pub(crate) fn literals(declared: &str) -> impl Iterator<Item = (&str, &str)> {
    let declared = declared.split(';').next().unwrap_or_default();
    declared.split(',').filter_map(|part| part.split_once(" = ")).map(trimmed)
}

fn trimmed<'a>((a, b): (&'a str, &'a str)) -> (&'a str, &'a str) {
    (a.trim(), b.trim())
}

/// Adds the lines of a file, with those of its includes in their places.
fn collect(path: &str, text: &dyn Fn(&str) -> Result<String, String>, lines: &mut Vec<Line>) -> Result<(), String> {
    let file = path.strip_prefix("include/").and_then(|file| file.strip_suffix(".glsl")).unwrap_or_default();
    for (n, line) in text(path)?.lines().enumerate() {
        if let Some(included) = line.strip_prefix("#include \"") {
            collect(&format!("include/{}", included.trim_end_matches('"')), text, lines)?;
            continue;
        }
        let (code, comment) = line.split_once("//").unwrap_or((line, ""));
        let (code, comment) = (code.trim_end().to_string(), comment.trim().to_string());
        lines.push(Line { place: format!("glsl/{path}:{}", n + 1), file: file.into(), code, comment });
    }
    Ok(())
}

fn scalar(kind: &str) -> (Scalar, u32) {
    let vector = |prefix: &str| kind.strip_prefix(prefix).and_then(|n| n.parse().ok()).filter(|n| (2..=4).contains(n));
    match kind {
        "float" => (Scalar::Float, 1),
        "int" => (Scalar::Int, 1),
        "uint" => (Scalar::Uint, 1),
        _ if vector("vec").is_some() => (Scalar::Float, vector("vec").unwrap_or(1)),
        _ if vector("ivec").is_some() => (Scalar::Int, vector("ivec").unwrap_or(1)),
        _ if vector("uvec").is_some() => (Scalar::Uint, vector("uvec").unwrap_or(1)),
        _ => (Scalar::Struct(kind.into()), 1),
    }
}

/// A binding from what follows its layout.
fn binding(number: usize, rest: &str, comment: &str) -> Result<Binding, String> {
    let (qualifiers, block) = rest.split_once('{').map_or((rest, None), |(head, block)| (head, Some(block)));
    let words: Vec<&str> = qualifiers.trim().trim_end_matches(';').split_whitespace().collect();
    let kind = match () {
        _ if words.contains(&"uimage2DArray") => Kind::Words,
        _ if words.contains(&"image2DArray") => Kind::Image,
        _ if words.contains(&"buffer") => Kind::Buffer,
        _ if block.is_some() => Kind::Uniform,
        _ => return Err("the binding is no image2DArray, uimage2DArray, buffer or block".into()),
    };
    let member = match block {
        None => words.last().copied().ok_or("the binding has no name")?,
        Some(block) => block.split(';').next().unwrap_or_default().trim(),
    };
    let (kind_of_member, name) = member.rsplit_once(' ').unwrap_or(("", member));
    let holds = kind_of_member.starts_with(char::is_uppercase).then(|| kind_of_member.to_string());
    let name = name.split('[').next().unwrap_or_default().to_string();
    let (reads, writes) = (!words.contains(&"writeonly"), kind != Kind::Uniform && !words.contains(&"readonly"));
    Ok(Binding { number, name, kind, reads, writes, holds, doc: comment.into() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Shader, String> {
        Shader::read("pass.comp", &|path| match path {
            "pass.comp" => Ok(text.into()),
            "include/part.glsl" => Ok("const int TERMS = 3, OTHERS = 4;\nstruct Part {\n    float a, b;\n};\n".into()),
            _ => Err(format!("{path} does not exist")),
        })
    }

    #[test]
    fn the_interface_of_a_shader_is_read_with_its_includes() {
        let shader =
            read("layout(local_size_x = OTHERS_TOO, local_size_y = 2, local_size_x_id = 0, local_size_y_id = 1) in;\n");
        assert_eq!(
            shader.unwrap_err(),
            "glsl/pass.comp:1: `OTHERS_TOO` is neither a literal nor a constant that is one"
        );
        let shader = read(concat!(
            "#include \"part.glsl\"\n",
            "layout(local_size_x = OTHERS, local_size_y = 2, local_size_x_id = 0, local_size_y_id = 1) in;\n",
            "layout(binding = 1, std430) readonly buffer Block { Part part; }; // what it holds\n",
            "layout(binding = 0, r32ui) uniform writeonly uimage2DArray to;\n",
            "layout(constant_id = 5) const bool FAST = false; // faster\n",
            "layout(push_constant) uniform Constants {\n",
            "    int width, height; // pixels\n",
            "    // Of both.\n",
            "    vec2 centre;\n",
            "    float weights[TERMS];\n",
            "    Part part;\n",
            "};\n",
        ))
        .unwrap();
        assert_eq!(shader.workgroup, Some([4, 2]));
        let bindings = shader.bindings.iter().map(|b| (b.name.as_str(), b.kind, b.reads, b.writes, b.holds.as_deref()));
        let expected = [("to", Kind::Words, false, true, None), ("part", Kind::Buffer, true, false, Some("Part"))];
        assert_eq!(bindings.collect::<Vec<_>>(), expected);
        assert_eq!(shader.flags, [Flag { id: 5, name: "FAST".into(), doc: "faster".into() }]);
        let members = shader.constants.iter().map(|m| (m.name.as_str(), m.width, m.count, m.doc.as_str()));
        let expected = [
            ("width", 1, None, "pixels"),
            ("height", 1, None, "pixels"),
            ("centre", 2, None, "Of both."),
            ("weights", 1, Some(3), ""),
            ("part", 1, None, ""),
        ];
        assert_eq!(members.collect::<Vec<_>>(), expected);
        assert_eq!(shader.offsets(&shader.constants).unwrap(), ((0..9).map(|n| 4 * n).collect(), 36));
    }

    #[test]
    fn errors_name_file_and_line() {
        let constants = |member: &str| {
            let shader = read(&format!("layout(push_constant) uniform Constants {{\n    int a;\n    {member}\n}};\n"))?;
            shader.offsets(&shader.constants)
        };
        let error = constants("vec2 centre;").unwrap_err();
        assert!(error.starts_with("glsl/pass.comp:3: `centre` begins at a multiple of 8 bytes"), "{error}");
        let error = constants("Other other;").unwrap_err();
        assert!(error.contains("glsl/pass.comp:3: the type `Other` is not known"), "{error}");
        let error = read("\nlayout(binding = 0) uniform sampler2D a;\n").unwrap_err();
        assert!(error.starts_with("glsl/pass.comp:2: the binding is no image2DArray"), "{error}");
        let error = read("layout(binding = 1, r32f) uniform image2DArray a;\n").unwrap_err();
        assert_eq!(error, "glsl/pass.comp: binding 0 is missing, or declared twice");
        assert!(read("layout(constant_id = 2) const int N = 1;\n").unwrap_err().contains("const bool NAME"));
        assert_eq!(read("#include \"none.glsl\"\n").unwrap_err(), "include/none.glsl does not exist");
    }
}
