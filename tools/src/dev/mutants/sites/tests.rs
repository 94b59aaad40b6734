//! What is found in a small shader, and what is left alone.

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
