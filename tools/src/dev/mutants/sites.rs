//! What can be changed in a shader: single faults that a programmer could have made.

use super::lexer;

mod code;
mod numbers;
mod statements;

use code::Code;
pub(super) use code::{Fault, Site};

/// All kinds, in the order in which mutants are drawn from them.
pub(super) const FAULTS: [Fault; 7] =
    [Fault::Operator, Fault::Constant, Fault::Barrier, Fault::Bound, Fault::Store, Fault::Atomic, Fault::Swizzle];

/// Operators and functions and what they are mistaken for.
const SWAPS: [(Fault, &str, &str); 34] = [
    (Fault::Operator, "+", "-"),
    (Fault::Operator, "-", "+"),
    (Fault::Operator, "*", "/"),
    (Fault::Operator, "/", "*"),
    (Fault::Operator, "%", "/"),
    (Fault::Operator, "+=", "-="),
    (Fault::Operator, "-=", "+="),
    (Fault::Operator, "*=", "/="),
    (Fault::Operator, "/=", "*="),
    (Fault::Operator, "|=", "&="),
    (Fault::Operator, "&=", "|="),
    (Fault::Operator, "++", "--"),
    (Fault::Operator, "--", "++"),
    (Fault::Operator, "&&", "||"),
    (Fault::Operator, "||", "&&"),
    (Fault::Operator, "&", "|"),
    (Fault::Operator, "|", "&"),
    (Fault::Operator, "^", "|"),
    (Fault::Operator, "<<", ">>"),
    (Fault::Operator, ">>", "<<"),
    (Fault::Operator, "==", "!="),
    (Fault::Operator, "!=", "=="),
    (Fault::Bound, "<", "<="),
    (Fault::Bound, "<=", "<"),
    (Fault::Bound, ">", ">="),
    (Fault::Bound, ">=", ">"),
    (Fault::Operator, "min", "max"),
    (Fault::Operator, "max", "min"),
    (Fault::Operator, "subgroupMin", "subgroupMax"),
    (Fault::Operator, "subgroupMax", "subgroupMin"),
    (Fault::Operator, "subgroupInclusiveAdd", "subgroupExclusiveAdd"),
    (Fault::Operator, "subgroupAny", "subgroupAll"),
    (Fault::Operator, "subgroupAll", "subgroupAny"),
    (Fault::Operator, "sin", "cos"),
];

/// Every change of a shader. Declarations of buffers, constants of specialisation, structures and shared memory stay as they
/// are: the first are checked against Rust, and more memory is no fault.
pub(super) fn sites(text: &str) -> Vec<Site> {
    let code = Code::of(text);
    let mut found = Vec::new();
    for at in 0..code.tokens.len() {
        code.swap(at, &mut found);
        code.swizzle(at, &mut found);
        code.index(at, &mut found);
        code.condition(at, &mut found);
        statements::of(&code, at, &mut found);
        numbers::of(&code, at, &mut found);
    }
    found
}

impl Code<'_> {
    fn swap(&self, at: usize, found: &mut Vec<Site>) {
        let word = self.word(at);
        let range = self.range(at);
        if matches!(word, "-" | "!" | "~") && !self.follows_value(at) {
            found.push(Site { fault: Fault::Operator, range, with: String::new() });
            return;
        }
        for (fault, _, with) in SWAPS.iter().filter(|(_, from, _)| *from == word) {
            found.push(Site { fault: *fault, range: range.clone(), with: (*with).to_owned() });
        }
    }

    /// `.x` becomes `.y`; the first two components of several change places.
    fn swizzle(&self, at: usize, found: &mut Vec<Site>) {
        let word = self.word(at);
        if self.before(at) != "." || word.len() > 4 || !word.chars().all(|c| "xyzw".contains(c)) {
            return;
        }
        let with = match word {
            "x" => "y".to_owned(),
            "y" => "x".to_owned(),
            "z" => "y".to_owned(),
            "w" => "z".to_owned(),
            _ => format!("{}{}{}", &word[1..2], &word[..1], &word[2..]),
        };
        found.push(Site { fault: Fault::Swizzle, range: self.range(at), with });
    }

    /// `[i]` becomes `[i + 1]` and `[i - 1]`; not the size of an array that is declared.
    fn index(&self, at: usize, found: &mut Vec<Site>) {
        if self.word(at) != "[" || !self.follows_value(at) || self.word(at + 1) == "]" {
            return;
        }
        let type_before = at >= 2 && self.kind(at - 2) == Some(lexer::Kind::Word) && self.word(at - 2) != "return";
        let declared = self.kind(at - 1) == Some(lexer::Kind::Word) && type_before;
        let Some(close) = self.close(at).filter(|_| !declared) else { return };
        let index = self.range(at).end..self.range(close).start;
        for step in ["+ 1", "- 1"] {
            let with = format!("({}) {step}", &self.text[index.clone()]);
            found.push(Site { fault: Fault::Bound, range: index.clone(), with });
        }
    }

    /// `if (…)` always or never: an early return that is left out, a guard that is missing.
    fn condition(&self, at: usize, found: &mut Vec<Site>) {
        let Some(close) = (self.word(at) == "if").then(|| self.close(at + 1)).flatten() else { return };
        for with in ["true", "false"] {
            let range = self.range(at + 1).end..self.range(close).start;
            found.push(Site { fault: Fault::Bound, range, with: with.to_owned() });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Fault, sites};

    /// `before -> after` of every change of this kind.
    fn changes(text: &str, fault: Fault) -> Vec<String> {
        let of_kind = sites(text).into_iter().filter(|s| s.fault == fault);
        of_kind.map(|s| format!("{} -> {}", &text[s.range.clone()], s.with)).collect()
    }

    #[test]
    fn each_kind_of_fault_is_found() {
        let cases = [
            (Fault::Operator, "x = -a + min(b, c);", vec!["- -> ", "+ -> -", "min -> max"]),
            (
                Fault::Constant,
                "x = 1.0 + 0x10u * 0.5;",
                vec!["1.0 -> 0.0", "1.0 -> 1.01", "0x10u -> 15u", "0x10u -> 17u", "0.5 -> 0.505", "0.5 -> 1.0"],
            ),
            (
                Fault::Barrier,
                "{ barrier(); subgroupMemoryBarrierShared(); }",
                vec!["barrier(); -> ", "subgroupMemoryBarrierShared(); -> "],
            ),
            (
                Fault::Bound,
                "if (i >= n) { return; } x = a[i];",
                vec!["i >= n -> true", "i >= n -> false", ">= -> >", "i -> (i) + 1", "i -> (i) - 1"],
            ),
            (Fault::Store, "float b = 2.0; a[i].x = b; s += f(b);", vec!["a[i].x = b; -> ", "s += f(b); -> "]),
            (
                Fault::Atomic,
                "atomicAdd(t[g(a, b)], n);",
                vec![" n ->  (n) + 1", "atomicAdd(t[g(a, b)], n) -> t[g(a, b)] += n"],
            ),
            (Fault::Swizzle, "a = v.xyz + p.w;", vec!["xyz -> yxz", "w -> z"]),
        ];
        for (fault, text, mut expected) in cases {
            let mut found = changes(text, fault);
            found.sort();
            expected.sort_unstable();
            let found: Vec<&str> = found.iter().map(|f| f.trim_start()).collect();
            let expected: Vec<&str> = expected.iter().map(|f| f.trim_start()).collect();
            assert_eq!(found, expected, "{text}");
        }
    }

    #[test]
    fn interfaces_and_sizes_stay() {
        let text = "layout(constant_id = 1) const uint K = 1u;\nshared uint s[64];\nstruct A { float b[3]; };\n\
                layout(std430, set = 0, binding = 2) buffer B { uint b[]; };\n#define BINDING 3\n";
        assert_eq!(sites(text), []);
        assert_eq!(changes("float own[8];", Fault::Bound), [""; 0]);
    }
}
