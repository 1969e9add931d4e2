//! The shaders of `glsl/`, their constants and structs, in tables that `build.rs` writes.
//!
//! A shader is a constant in capitals, named after its file: `shaders::RELAX`. The module `shaders::NAME` holds what
//! `glsl/NAME.comp` or `glsl/include/NAME.glsl` declares, so that Rust does not repeat it: literal constants; the push
//! constants, `Constants`; structs that push constants and buffers use. Fields have the names of the members. Integers
//! are unsigned. `stages::interface` has the bindings.

/// A compute shader.
#[derive(Debug)]
pub struct Shader {
    /// Its file in `glsl/`, without `.comp`.
    pub name: &'static str,
    /// SPIR-V 1.6 for Vulkan 1.3, entry point `main`, little endian.
    pub spirv: &'static [u8],
}

#[allow(dead_code, missing_docs, clippy::all, reason = "generated; Rust uses some of it")]
#[rustfmt::skip]
mod table {
    use super::Shader;

    include!(concat!(env!("OUT_DIR"), "/shaders.rs"));
}

pub use table::*;

// The parts of the build script that have tests.
#[cfg(test)]
#[allow(dead_code)]
#[path = "../../build/glsl.rs"]
mod glsl;
#[cfg(test)]
#[path = "../../build/spirv.rs"]
mod spirv;

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    #[cfg(feature = "files")]
    #[test]
    fn the_compiled_shaders_are_those_of_the_sources() {
        use crate::files::bounded_read::Hash;

        let file = |name: &str| format!("{}/{name}", env!("CARGO_MANIFEST_DIR"));
        let sources = std::fs::read_to_string(file("glsl/spirv/SOURCES")).unwrap();
        for line in sources.lines() {
            let (sum, name) = line.split_once("  ").unwrap();
            let found = Hash::of(std::fs::File::open(file(name)).unwrap()).unwrap();
            assert_eq!(found.sha256, sum, "{name} has changed: run tools/spirv");
        }
        let count = |folder: &str, ending: &str| {
            let names = std::fs::read_dir(file(folder)).unwrap().map(|entry| entry.unwrap().file_name());
            names.filter(|name| name.to_string_lossy().ends_with(ending)).count()
        };
        let all = count("glsl", ".comp") + count("glsl/include", "");
        assert_eq!(sources.lines().count(), 1 + all, "a shader is new or gone: run tools/spirv");
    }

    /// What a shader does to a member of a buffer or to an image that it reads and writes.
    #[derive(Clone, Debug, PartialEq)]
    enum Event {
        /// By all invocations, or by one alone.
        Read(String, bool),
        /// By all invocations, or by one alone.
        Write(String, bool),
        Barrier,
    }

    /// The text of a shader with its includes, without comments.
    fn text(path: &str) -> String {
        let text = std::fs::read_to_string(format!("{}/glsl/{path}", env!("CARGO_MANIFEST_DIR"))).unwrap();
        let line = |line: &str| match line.strip_prefix("#include \"") {
            Some(rest) => self::text(&format!("include/{}", rest.trim_end_matches('"'))),
            None if line.starts_with('#') => String::new(),
            None => line.split("//").next().unwrap_or_default().to_string() + "\n",
        };
        text.lines().map(line).collect()
    }

    /// Names with their members but without indices, and operators of up to two characters.
    fn tokens(text: &str) -> Vec<String> {
        let chars: Vec<char> = text.chars().collect();
        let is_name = |c: char| c.is_alphanumeric() || c == '_' || c == '.';
        let (mut tokens, mut at): (Vec<String>, _) = (Vec::new(), 0);
        while at < chars.len() {
            let start = at;
            if is_name(chars[at]) {
                while at < chars.len() && is_name(chars[at]) {
                    at += 1;
                }
                let name: String = chars[start..at].iter().collect();
                match tokens.last_mut() {
                    Some(last) if name.starts_with('.') && is_name(last.chars().next().unwrap()) => {
                        last.push_str(&name)
                    }
                    _ => tokens.push(name),
                }
            } else if chars[at] == '[' {
                let mut depth = 0;
                loop {
                    depth += i32::from(chars[at] == '[') - i32::from(chars[at] == ']');
                    at += 1;
                    if depth == 0 {
                        break;
                    }
                }
            } else if chars[at].is_whitespace() {
                at += 1;
            } else {
                at += 1 + usize::from(chars.get(at + 1) == Some(&'=') && "=!<>+-*/|&".contains(chars[at]));
                tokens.push(chars[start..at].iter().collect());
            }
        }
        tokens
    }

    /// Where the bracket that opens at a token closes.
    fn closing(tokens: &[String], open: usize) -> usize {
        let (left, right) = if tokens[open] == "(" { ("(", ")") } else { ("{", "}") };
        let mut depth = 0;
        (open..tokens.len())
            .find(|&n| {
                depth += i32::from(tokens[n] == left) - i32::from(tokens[n] == right);
                depth == 0
            })
            .unwrap()
    }

    /// Walks through the functions of a shader in the order of execution.
    struct Walk {
        functions: HashMap<String, Vec<String>>,
        shared_by_dispatch: Vec<String>,
        events: Vec<Event>,
    }

    impl Walk {
        fn new(shader: &str) -> Self {
            let text = text(shader);
            let declared = text.lines().filter(|line| line.contains("binding = "));
            let both =
                declared.filter(|line| !["readonly", "writeonly", "coherent"].iter().any(|word| line.contains(word)));
            let name = |line: &str| {
                let line = line.split("};").next().unwrap_or_default().trim_end_matches([' ', ';']);
                line.rsplit(' ').next().unwrap_or_default().trim_end_matches("[]").to_string()
            };
            let shared_by_dispatch = both.filter(|line| !line.contains("std140")).map(name).collect();
            let tokens = tokens(&text);
            let (mut functions, mut at) = (HashMap::new(), 0);
            while at < tokens.len() {
                if tokens[at] == "{" {
                    let end = closing(&tokens, at);
                    if tokens[at - 1] == ")" {
                        let open = (0..at).rev().find(|&n| tokens[n] == "(" && closing(&tokens, n) == at - 1).unwrap();
                        functions
                            .entry(tokens[open - 1].clone())
                            .or_insert_with(Vec::new)
                            .extend_from_slice(&tokens[at + 1..end]);
                    }
                    at = end;
                }
                at += 1;
            }
            Self { functions, shared_by_dispatch, events: Vec::new() }
        }

        /// The end of the statement or block that begins at a token.
        fn statement_end(tokens: &[String], at: usize) -> usize {
            match tokens[at].as_str() {
                "{" => closing(tokens, at) + 1,
                "if" | "for" => Self::statement_end(tokens, closing(tokens, at + 1) + 1),
                _ => tokens[at..].iter().position(|token| token == ";").map_or(tokens.len(), |n| at + n + 1),
            }
        }

        fn walk(&mut self, tokens: &[String], mut alone: bool) {
            let mut at = 0;
            while at < tokens.len() {
                match tokens[at].as_str() {
                    "if" | "for" => {
                        let head = closing(tokens, at + 1);
                        let end = Self::statement_end(tokens, head + 1);
                        let condition = tokens[at + 2..head].join(" ");
                        let invocation = ["gl_LocalInvocationIndex", "n", "first", "x"];
                        let one = invocation.iter().any(|i| {
                            condition.starts_with(&format!("{i} == 0")) || condition == format!("{i} == ivec2 ( 0 )")
                        });
                        self.walk(&tokens[at + 2..head], alone);
                        for _ in 0..if tokens[at] == "for" { 2 } else { 1 } {
                            self.walk(&tokens[head + 1..end], alone || one);
                        }
                        let others_return = invocation.iter().any(|i| condition.starts_with(&format!("{i} != 0")));
                        alone |= others_return && tokens[head + 1] == "return";
                        at = end;
                        continue;
                    }
                    "barrier" => self.events.push(Event::Barrier),
                    call if tokens.get(at + 1).is_some_and(|next| next == "(") && self.functions.contains_key(call) => {
                        let body = self.functions[call].clone();
                        self.walk(&body, alone);
                    }
                    path if self.shared_by_dispatch.iter().any(|name| path.split('.').next() == Some(name)) => {
                        let next = tokens.get(at + 1).map_or("", String::as_str);
                        let stores = at > 1 && tokens[at - 2] == "imageStore";
                        if !stores && next != "=" {
                            self.events.push(Event::Read(path.to_string(), alone));
                        }
                        if stores || next.ends_with('=') && !["==", "!=", "<=", ">="].contains(&next) {
                            self.events.push(Event::Write(path.to_string(), alone));
                        }
                    }
                    _ => {}
                }
                at += 1;
            }
        }

        /// The members that other invocations read than the one that writes them, though neither `barrier()` nor the
        /// end of the dispatch stands between.
        fn races(mut self) -> Vec<String> {
            let main = self.functions["main"].clone();
            self.walk(&main, false);
            let overlaps =
                |a: &str, b: &str| a == b || a.starts_with(&format!("{b}.")) || b.starts_with(&format!("{a}."));
            let mut races = Vec::new();
            for (w, event) in self.events.iter().enumerate() {
                let Event::Write(written, by_one) = event else { continue };
                for (r, event) in self.events.iter().enumerate() {
                    let Event::Read(read, false) = event else { continue };
                    let barrier = self.events[w.min(r)..w.max(r)].contains(&Event::Barrier);
                    if overlaps(written, read) && if *by_one { r > w || !barrier } else { r > w && barrier } {
                        races.push(format!("{written}, read as {read}"));
                    }
                }
            }
            races.dedup();
            races
        }
    }

    /// `linearise` binds the state twice, as the compiler takes fewer registers then: all workgroups read `state`, and
    /// the last one, which steps, reads and writes `updated`. A compiler may take them for different memory.
    #[test]
    fn the_step_of_t_reads_the_state_only_as_it_writes_it() {
        let tokens = tokens(&text("include/update_transform.glsl"));
        let reads = |token: &&String| token.split('.').next() == Some("state");
        assert_eq!(tokens.iter().find(reads), None);
        assert!(tokens.iter().any(|token| token.starts_with("updated.")));
    }

    #[test]
    fn shaders_that_store_or_test_nan_declare_that_it_keeps_its_meaning() {
        for shader in shaders() {
            let text = text(&shader);
            let relies = ["isnan(", "0x7fc00000u"].iter().any(|word| text.contains(word));
            assert!(!relies || text.contains("spirv_execution_mode"), "glsl/{shader}: include nan.glsl");
        }
    }

    /// Vulkan lets arc tangents err by 4096 units in the last place, and sines by 2⁻¹¹: more than replays tolerate.
    #[test]
    fn no_shader_uses_functions_that_may_err_by_thousands_of_units_in_the_last_place() {
        const IMPRECISE: [&str; 9] = ["sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"];
        for shader in shaders() {
            let tokens = tokens(&text(&shader));
            let used = tokens.windows(2).find(|pair| IMPRECISE.contains(&pair[0].as_str()) && pair[1] == "(");
            assert_eq!(used, None, "glsl/{shader}");
        }
    }

    fn shaders() -> Vec<String> {
        let folder = std::fs::read_dir(format!("{}/glsl", env!("CARGO_MANIFEST_DIR"))).unwrap();
        let names = folder.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.filter(|name| name.ends_with(".comp")).collect()
    }

    #[test]
    fn no_invocation_reads_from_a_buffer_or_image_what_another_writes_in_the_same_dispatch() {
        for shader in shaders() {
            let races = Walk::new(&shader).races();
            assert!(races.is_empty(), "glsl/{shader}: {races:?}: keep it in shared memory, or declare it coherent");
        }
    }
}
