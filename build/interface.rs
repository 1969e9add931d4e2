//! Writes the Rust modules of the shaders' interfaces.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use super::glsl::{Binding, Member, Scalar, Shader};

/// The structs of the state, and the names of their counterparts in double precision.
const DOUBLE: [(&str, &str); 2] = [("State", "DoubleState"), ("LevelState", "DoubleLevel")];

const DERIVED: &str = "#[repr(C)]\n#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]\n";

/// The Rust of a shader's push constants.
pub(crate) fn of_constants(shader: &Shader) -> String {
    match shader.constants_file.as_str() {
        "" => push_constants(shader),
        file => format!("pub use super::{file}::Constants;\n"),
    }
}

/// The Rust of a shader's bindings and stage: a module that also exports its constants.
pub(crate) fn of_stage(name: &str, shader: &Shader) -> Result<String, String> {
    let workgroup = shader.workgroup.ok_or_else(|| format!("glsl/{name}.comp: it does not declare its workgroup"))?;
    let (_, constant_bytes) = shader.offsets(&shader.constants)?;
    if constant_bytes > 128 {
        return Err(format!("glsl/{name}.comp: {constant_bytes} bytes of push constants; devices may have only 128"));
    }
    let mut text = format!("pub mod {name} {{\nuse super::*;\npub use shaders::{name}::*;\n");
    let (mut bindings, mut declared, mut names) = (String::new(), String::new(), Vec::new());
    for Binding { name, kind, reads, writes, doc, .. } in &shader.bindings {
        let [access, handle] = match (reads, writes) {
            (true, false) => ["Read", "Reads"],
            (false, _) => ["Write", "Writes"],
            (true, true) => ["Update", "Updates"],
        };
        let _ = write!(bindings, "{}pub(crate) {name}: {handle}, ", doc_comment(doc));
        let _ = write!(declared, "Binding {{ name: {name:?}, kind: Kind::{kind:?}, access: Access::{access} }}, ");
        names.push(name.as_str());
    }
    text += "/// The bindings, in the shader's order.\n#[derive(Clone, Copy, Debug)]\n";
    let _ = writeln!(text, "pub(crate) struct Bindings {{ {bindings} }}");
    let flags = shader.flags.iter().map(|flag| format!(".or(Variant::{})", flag.name)).collect::<String>();
    let _ = write!(
        text,
        "/// The shader and its layout.\npub(crate) const STAGE: Stage = Stage {{ shader: &shaders::{}, bindings: &[{declared}], \
         constant_bytes: {constant_bytes}, flags: Variant::NONE{flags}, workgroup: {workgroup:?} }};\n",
        name.to_uppercase()
    );
    let slots: String = names.iter().map(|name| format!("self.{name}.slot(), ")).collect();
    let of: String = names.iter().map(|name| format!("{name}: Bound::of({name}), ")).collect();
    let has = |name: &str| shader.constants.iter().any(|member| member.name == name && member.count.is_none());
    let size = if has("width") && has("height") { "[_c.width, _c.height]" } else { "[0; 2]" };
    let _ = write!(
        text,
        "impl pass::Bindings for Bindings {{ type Constants = Constants; const STAGE: &'static Stage = &STAGE; \
         fn slots(&self) -> Vec<Slot> {{ vec![{slots}] }} \
         fn of(slots: &[Slot]) -> Self {{ let &[{}] = slots else {{ unreachable!(\"slots of {name}\") }}; Self {{ {of} }} }} \
         fn size(_c: &Constants) -> [u32; 2] {{ {size} }} }}\n\
         impl Bindings {{ pub(crate) fn on(level: usize) -> Self {{ pass::on(level) }} }}\n}}\n",
        names.join(", ")
    );
    Ok(text)
}

fn push_constants(shader: &Shader) -> String {
    fields("Constants", "Push constants.", &shader.constants, shader)
}

/// The Rust of the push constants and structs that an include declares and interfaces use.
pub(crate) fn of_structs<'a>(file: &str, shaders: impl Iterator<Item = &'a Shader>) -> String {
    let mut structs = BTreeMap::new();
    for shader in shaders {
        if shader.constants_file == file {
            structs.entry("Constants".into()).or_insert_with(|| push_constants(shader));
        }
        let mut used = BTreeSet::new();
        use_structs(&shader.constants, shader, &mut used);
        let held = shader.bindings.iter().filter_map(|binding| binding.holds.clone());
        for name in held.collect::<BTreeSet<_>>() {
            use_structs(&shader.structs[&name].members, shader, &mut used);
            used.insert(name);
        }
        for name in used.into_iter().filter(|name| shader.structs[name].file == file) {
            let members = &shader.structs[&name].members;
            structs
                .entry(name.clone())
                .or_insert_with(|| fields(&name, &format!("`{name}` of the shaders."), members, shader));
        }
    }
    structs.into_values().collect()
}

fn use_structs(members: &[Member], shader: &Shader, used: &mut BTreeSet<String>) {
    for member in members {
        if let Scalar::Struct(name) = &member.kind {
            use_structs(&shader.structs[name].members, shader, used);
            used.insert(name.clone());
        }
    }
}

/// The Rust of the state in double precision, and of its conversions.
pub(crate) fn of_double<'a>(mut shaders: impl Iterator<Item = &'a Shader>) -> Result<String, String> {
    let shader = shaders.find(|shader| shader.structs.contains_key("State")).ok_or("no shader has the state")?;
    let mut text = String::new();
    for (name, double) in DOUBLE {
        let members = &shader.structs[name].members;
        let _ = writeln!(text, "/// `{name}` in double precision.\n#[derive(Clone, Debug)]\npub struct {double} {{");
        for member in members {
            let kind = kind(member, shader).replace("super::", "shaders::");
            let _ = writeln!(text, "{}pub {}: <{kind} as Double>::Of,", doc_comment(&member.doc), member.name);
        }
        let all = |call: &str| members.iter().map(|m| format!("{0}: {call}(&from.{0}), ", m.name)).collect::<String>();
        let _ = writeln!(
            text,
            "}}\nimpl Double for {name} {{ type Of = {double}; \
             fn double(&self) -> {double} {{ let from = self; {double} {{ {} }} }} \
             fn single(from: &{double}) -> Self {{ Self {{ {} }} }} }}\n\
             impl From<&{name}> for {double} {{ fn from(single: &{name}) -> Self {{ single.double() }} }}\n\
             impl From<&{double}> for {name} {{ fn from(double: &{double}) -> Self {{ Double::single(double) }} }}",
            all("Double::double"),
            all("Double::single")
        );
    }
    Ok(text)
}

/// The Rust of all flags: constants of `Variant`. One name has one number in all shaders.
pub(crate) fn of_flags(shaders: &BTreeMap<String, Shader>) -> Result<String, String> {
    let mut flags = BTreeMap::<&str, (u32, BTreeMap<&str, Vec<&str>>)>::new();
    for (shader, Shader { flags: declared, .. }) in shaders {
        for flag in declared {
            let (id, docs) = flags.entry(&flag.name).or_insert((flag.id, BTreeMap::new()));
            if *id != flag.id || !(2..8).contains(id) {
                return Err(format!(
                    "glsl/{shader}.comp: `{}` is constant {}: it must be {id} as in other shaders, from 2 to 7",
                    flag.name, flag.id
                ));
            }
            docs.entry(&flag.doc).or_default().push(shader);
        }
    }
    let mut text = String::from("impl Variant {\n");
    for (name, (id, docs)) in flags {
        for (doc, shaders) in docs {
            text += &doc_comment(&format!("{}: {doc}", shaders.join(", ")));
        }
        let _ = writeln!(text, "pub(crate) const {name}: Self = Self::flag({id});");
    }
    Ok(text + "}\n")
}

/// A struct with these members.
fn fields(name: &str, doc: &str, members: &[Member], shader: &Shader) -> String {
    let mut text = format!("/// {doc}\n{DERIVED}pub struct {name} {{\n");
    for member in members {
        let _ = writeln!(text, "{}pub {}: {},", doc_comment(&member.doc), member.name, kind(member, shader));
    }
    text + "}\n"
}

/// The Rust type of a member. A word that holds the bits of a float is a float.
fn kind(member: &Member, shader: &Shader) -> String {
    let element = match &member.kind {
        Scalar::Float => "f32".into(),
        Scalar::Uint if member.doc.starts_with("bits of the largest") => "f32".into(),
        Scalar::Int | Scalar::Uint => "u32".into(),
        Scalar::Struct(name) => format!("super::{}::{name}", shader.structs[name].file),
    };
    let element = if member.width == 1 { element } else { format!("[{element}; {}]", member.width) };
    member.count.map_or(element.clone(), |count| format!("[{element}; {count}]"))
}

fn doc_comment(doc: &str) -> String {
    if doc.is_empty() { String::new() } else { format!("#[doc = {:?}]\n", format!(" {doc}")) }
}
