//! Compares the interface that was read from a shader's text with its SPIR-V.

use std::collections::{BTreeMap, HashMap};

use super::glsl::{Kind, Shader};

// Instructions and decorations of the SPIR-V specification.
const TYPE_INT: u32 = 21;
const TYPE_FLOAT: u32 = 22;
const TYPE_VECTOR: u32 = 23;
const TYPE_IMAGE: u32 = 25;
const TYPE_ARRAY: u32 = 28;
const TYPE_RUNTIME_ARRAY: u32 = 29;
const TYPE_STRUCT: u32 = 30;
const TYPE_POINTER: u32 = 32;
const CONSTANT: u32 = 43;
const SPEC_CONSTANT: u32 = 50;
const VARIABLE: u32 = 59;
const DECORATE: u32 = 71;
const MEMBER_DECORATE: u32 = 72;
const SPEC_ID: u32 = 1;
const ARRAY_STRIDE: u32 = 6;
const NON_WRITABLE: u32 = 24;
const NON_READABLE: u32 = 25;
const BINDING: u32 = 33;
const OFFSET: u32 = 35;
const PUSH_CONSTANT: u32 = 9;
const UNIFORM: u32 = 2;

/// The instructions that declare the interface, by the identifiers of their results.
#[derive(Default)]
struct Module {
    /// Types, constants and variables: the instruction and its operands without the result.
    declared: HashMap<u32, (u32, Vec<u32>)>,
    /// Decorations of an identifier or, with `Some`, of a member of a type.
    decorations: BTreeMap<(u32, Option<u32>, u32), u32>,
}

impl Module {
    fn read(words: &[u32]) -> Option<Self> {
        let (mut module, mut at) = (Self::default(), 5);
        while at < words.len() {
            let (opcode, count) = (words[at] & 0xffff, (words[at] >> 16) as usize);
            let operands = words.get(at + 1..at + count).filter(|_| count > 0)?;
            match opcode {
                TYPE_INT | TYPE_FLOAT | TYPE_VECTOR | TYPE_IMAGE | TYPE_ARRAY | TYPE_RUNTIME_ARRAY | TYPE_STRUCT
                | TYPE_POINTER => {
                    module.declared.insert(operands[0], (opcode, operands[1..].to_vec()));
                }
                CONSTANT | SPEC_CONSTANT | VARIABLE => {
                    module.declared.insert(operands[1], (opcode, [&operands[..1], &operands[2..]].concat()));
                }
                DECORATE => {
                    let value = operands.get(2).copied().unwrap_or(0);
                    module.decorations.insert((operands[0], None, operands[1]), value);
                }
                MEMBER_DECORATE => {
                    let value = operands.get(3).copied().unwrap_or(0);
                    module.decorations.insert((operands[0], Some(operands[1]), operands[2]), value);
                }
                _ => {}
            }
            at += count;
        }
        Some(module)
    }

    fn decoration(&self, id: u32, member: Option<u32>, decoration: u32) -> Option<u32> {
        self.decorations.get(&(id, member, decoration)).copied()
    }

    /// The offsets of all scalars of a type; none for an array without a length.
    fn offsets(&self, id: u32, at: u32, offsets: &mut Vec<u32>) {
        match self.declared.get(&id) {
            Some((TYPE_STRUCT, members)) => {
                for (n, &member) in (0..).zip(members) {
                    self.offsets(member, at + self.decoration(id, Some(n), OFFSET).unwrap_or(0), offsets);
                }
            }
            Some((TYPE_ARRAY, element)) => {
                let count = self.declared.get(&element[1]).map_or(0, |(_, constant)| constant[1]);
                let stride = self.decoration(id, None, ARRAY_STRIDE).unwrap_or(0);
                (0..count).for_each(|n| self.offsets(element[0], at + n * stride, offsets));
            }
            Some((TYPE_VECTOR, element)) => offsets.extend((0..element[1]).map(|n| at + 4 * n)),
            Some((TYPE_INT | TYPE_FLOAT, _)) => offsets.push(at),
            _ => {}
        }
    }

    /// The variables: identifier, storage class and the type that they point to.
    fn variables(&self) -> impl Iterator<Item = (u32, u32, u32)> {
        self.declared.iter().filter(|(_, (opcode, _))| *opcode == VARIABLE).filter_map(|(&id, (_, operands))| {
            let (_, pointer) = self.declared.get(&operands[0])?;
            Some((id, operands[1], pointer[1]))
        })
    }
}

/// Fails where the text of a shader and its SPIR-V declare different interfaces. What a shader does not use, its SPIR-V
/// does not declare.
pub(crate) fn verify(shader: &Shader, spirv: &[u8]) -> Result<(), String> {
    let words: Vec<u32> = spirv.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let module = Module::read(&words).ok_or("it is not SPIR-V")?;
    for (id, class, kind) in module.variables() {
        let offsets = || {
            let mut offsets = Vec::new();
            module.offsets(kind, 0, &mut offsets);
            offsets
        };
        if class == PUSH_CONSTANT && offsets() != shader.offsets(&shader.constants)?.0 {
            return Err("the push constants differ".into());
        }
        let Some(number) = module.decoration(id, None, BINDING) else { continue };
        let differs = |what: &str| format!("binding {number} differs: {what}");
        let binding = shader.bindings.get(number as usize).ok_or_else(|| differs("the text has none"))?;
        let declared = match module.declared.get(&kind) {
            Some((TYPE_IMAGE, operands)) => match module.declared.get(&operands[0]) {
                Some((TYPE_FLOAT, _)) => Kind::Image,
                _ => Kind::Words,
            },
            _ if class == UNIFORM => Kind::Uniform,
            _ => Kind::Buffer,
        };
        if declared != binding.kind {
            return Err(differs("its kind"));
        }
        let has = |decoration| {
            let of_member = module.decoration(kind, Some(0), decoration);
            module.decoration(id, None, decoration).or(of_member).is_some()
        };
        if declared != Kind::Uniform && [has(NON_READABLE), has(NON_WRITABLE)] != [!binding.reads, !binding.writes] {
            return Err(differs("its access"));
        }
        if let Some(held) = binding.holds.as_ref().and_then(|name| shader.structs.get(name))
            && offsets() != shader.offsets(&held.members)?.0
        {
            return Err(differs("its struct"));
        }
    }
    for (&(id, _, decoration), &number) in &module.decorations {
        let Some((opcode, operands)) = module.declared.get(&id).filter(|_| decoration == SPEC_ID) else { continue };
        let side = shader.workgroup.and_then(|sides| sides.get(number as usize).copied());
        if *opcode == SPEC_CONSTANT && side != Some(operands[1]) {
            return Err("the workgroup differs".into());
        }
    }
    let ids = module.decorations.iter().filter(|((_, _, decoration), _)| *decoration == SPEC_ID).map(|(_, &id)| id);
    match ids.filter(|&id| id > 1).find(|id| shader.flags.iter().all(|flag| flag.id != *id)) {
        Some(id) => Err(format!("the text has no specialization constant {id}")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = concat!(
        "layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;\n",
        "layout(binding = 0, r32f) uniform readonly image2DArray from;\n",
        "layout(binding = 1, r32f) uniform writeonly image2DArray to;\n",
        "layout(push_constant) uniform Constants { int width, height, layer; };\n",
    );

    #[test]
    fn a_text_that_differs_from_the_spirv_is_refused() {
        let spirv = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/glsl/spirv/copy.spv")).unwrap();
        let check = |from: &str, to: &str| {
            let shader = Shader::read("copy.comp", &|_| Ok(TEXT.replace(from, to))).unwrap();
            verify(&shader, &spirv)
        };
        assert_eq!(check("", ""), Ok(()));
        for (from, to, error) in [
            ("width, height", "width", "the push constants differ"),
            ("readonly", "", "binding 0 differs: its access"),
            ("image2DArray to", "uimage2DArray to", "binding 1 differs: its kind"),
            (
                "layout(binding = 1, r32f) uniform writeonly image2DArray to;\n",
                "",
                "binding 1 differs: the text has none",
            ),
            ("local_size_y = 4", "local_size_y = 2", "the workgroup differs"),
        ] {
            assert_eq!(check(from, to), Err(error.to_string()));
        }
        assert_eq!(verify(&Shader::default(), &[0; 24]), Err("it is not SPIR-V".into()));
    }
}
