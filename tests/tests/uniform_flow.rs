//! The checker of uniform flow: planted breaches are found and named, what keeps the rules is let through, and all committed
//! kernels keep them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use tools::dev::uniform_flow::violations;

/// What all planted shaders begin with.
const HEAD: &str = "#version 460
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_KHR_shader_subgroup_arithmetic : require
layout(local_size_x = 256) in;
layout(constant_id = 0) const uint SUBGROUP_SIZE = 32u;
layout(constant_id = 1) const uint STAGE = 0u;
layout(constant_id = 2) const uint MODE = 0u;
layout(std430, set = 0, binding = 0) readonly buffer GivenBlock { uint given[]; };
layout(std430, set = 0, binding = 1) buffer ChangedBlock { uint changed[]; };
layout(push_constant) uniform PushBlock { uint n; } push;
shared uint slots[256];
uint lane() { return gl_SubgroupInvocationID; }
";

fn compile(source: &str) -> Vec<u8> {
    let mut glslc = Command::new("glslc")
        .args(["--target-env=vulkan1.2", "--target-spv=spv1.5", "-O0", "-fshader-stage=compute", "-", "-o", "-"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("glslc, which ci/setup --tests installs");
    glslc.stdin.take().unwrap().write_all(source.as_bytes()).unwrap();
    let ran = glslc.wait_with_output().unwrap();
    assert!(ran.status.success(), "{}\n{source}", String::from_utf8_lossy(&ran.stderr));
    ran.stdout
}

fn check(body: &str) -> Vec<String> {
    violations(Path::new("planted.spv"), &compile(&format!("{HEAD}{body}"))).unwrap()
}

/// Each body breaks a rule in the way that the text says.
#[test]
fn breaches_are_found_and_named() {
    let planted: &[(&str, &str)] = &[
        (
            "void main() { if (lane() > push.n) { return; } barrier(); changed[0] = 1u; }",
            "OpControlBarrier 1 of main depends on a branch of main on `gl_SubgroupInvocationID`, in which lanes differ",
        ),
        (
            "void main() { if (lane() > push.n) { return; } changed[0] = subgroupAdd(1u); }",
            "OpGroupNonUniformIAdd 1 of main depends on",
        ),
        (
            "void main() { if (gl_SubgroupID == 0u) { slots[0] = 1u; barrier(); } changed[0] = slots[0]; }",
            "OpControlBarrier 1 of main depends on a branch of main on `gl_SubgroupID`, in which subgroups differ",
        ),
        // Some drivers make a barrier of the whole workgroup of a subgroup's.
        ("void main() { if (gl_SubgroupID == 0u) { subgroupBarrier(); } }", "OpControlBarrier 1 of main"),
        (
            "void main() { if (lane() < 3u) { changed[0] = subgroupBallot(true).x; } }",
            "OpGroupNonUniformBallot 1 of main depends on a branch of main on `gl_SubgroupInvocationID`",
        ),
        (
            "uint early(uint x) { if (x > 3u) { return 1u; } return given[x]; }
             void main() { uint y = early(lane()); changed[0] = subgroupAdd(y); }",
            "a return of early depends on a branch of early on `gl_SubgroupInvocationID`, in which lanes differ",
        ),
        (
            "void main() { for (uint i = lane(); i < push.n; i += 4u) { barrier(); } }",
            "OpControlBarrier 1 of main depends on",
        ),
        (
            "void main() { for (uint i = 0u; i < push.n; i++) { barrier(); if (given[lane()] == i) { break; } } }",
            "OpControlBarrier 1 of main depends on a branch of main on `i`, in which lanes differ",
        ),
        (
            "void main() { for (uint i = 0u; i < push.n; i++) { if (lane() == i) { continue; } subgroupBarrier(); } }",
            "OpControlBarrier 1 of main depends on",
        ),
        (
            "void main() { if (lane() < 3u && subgroupAny(given[lane()] == 1u)) { changed[0] = 1u; } }",
            "OpGroupNonUniformAny 1 of main depends on",
        ),
        (
            "void main() { if (atomicAdd(changed[1], 1u) == 0u) { barrier(); } }",
            "OpControlBarrier 1 of main depends on a branch of main on OpAtomicIAdd",
        ),
        // Others may write it meanwhile, so that two lanes can find different things.
        ("void main() { if (changed[1] == 0u) { barrier(); } }", "OpControlBarrier 1 of main"),
        (
            "void inner() { subgroupMemoryBarrierShared(); subgroupBarrier(); }
             void outer(bool go) { if (go) { inner(); } }
             void main() { outer(given[lane()] == 0u); }",
            "OpControlBarrier 1 of inner depends on a branch of outer on `gl_SubgroupInvocationID`",
        ),
        (
            "void classify(uint x, out bool large) { large = x > 7u; }
             void main() { bool large; classify(lane(), large); if (large) { changed[0] = subgroupAdd(1u); } }",
            "OpGroupNonUniformIAdd 1 of main depends on",
        ),
        // The counter is the same in every round, but lanes leave in different ones.
        (
            "void main() {
                 uint rounds = 0u;
                 while (rounds < given[lane()]) { rounds++; }
                 if (rounds > push.n) { changed[0] = subgroupAdd(1u); }
             }",
            "OpGroupNonUniformIAdd 1 of main depends on",
        ),
        (
            "void main() { uint kept[4]; kept[lane() & 3u] = 1u; if (kept[0] == 1u) { barrier(); } }",
            "OpControlBarrier 1 of main",
        ),
        (
            "void main() { switch (lane()) { case 0u: changed[0] = subgroupAdd(1u); break; default: break; } }",
            "OpGroupNonUniformIAdd 1 of main depends on",
        ),
        (
            "void main() { uint x = subgroupInclusiveAdd(1u); if (x > 3u) { changed[0] = subgroupAdd(x); } }",
            "OpGroupNonUniformIAdd 2 of main depends on a branch of main on",
        ),
        // Only one choice of the constant is wrong.
        (
            "void main() {
                 bool open = subgroupAny(given[lane()] == 1u);
                 if (open) { uint stage = STAGE; if (stage == 1u) { subgroupBarrier(); } }
             }",
            "in which subgroups differ (STAGE = 1)",
        ),
        (
            "void main() { slots[gl_LocalInvocationID.x] = gl_SubgroupID; barrier(); changed[0] = slots[0]; }",
            "invocations are numbered by SubgroupId and by LocalInvocationId",
        ),
        // Ranking as it was in the sort: only the subgroups whose turn it is meet at the inner barriers.
        (
            "void main() {
                 uint size = SUBGROUP_SIZE;
                 uint share = max(256u / size / 16u, 1u);
                 for (uint turn = 0u; turn < share; turn++) {
                     barrier();
                     if (gl_SubgroupID % share == turn) {
                         for (uint r = 0u; r < 16u; r++) {
                             uint seen = slots[given[lane() + r] & 255u];
                             subgroupMemoryBarrierShared();
                             subgroupBarrier();
                             slots[given[lane() + r] & 255u] = seen + 1u;
                             subgroupMemoryBarrierShared();
                             subgroupBarrier();
                         }
                     }
                 }
             }",
            "OpControlBarrier 2 of main depends on a branch of main on `gl_SubgroupID`, in which subgroups differ",
        ),
    ];
    for (body, expected) in planted {
        let found = check(body);
        assert!(found.iter().any(|line| line.contains(expected)), "expected: {expected}\nfound: {found:#?}\n{body}");
    }
}

/// None of these breaks a rule, though each comes near.
#[test]
fn uniform_flow_is_let_through() {
    let kept: &[&str] = &[
        "void main() { if (push.n > 3u) { barrier(); } }",
        "void main() { for (uint i = 0u; i < given[gl_WorkGroupID.x]; i++) { barrier(); } }",
        "void main() { if (gl_SubgroupID == 0u) { changed[0] = subgroupAdd(1u); } barrier(); }",
        "void main() { if (subgroupAny(given[lane()] == 1u)) { changed[0] = subgroupBallot(true).x; } }",
        "void main() { if (lane() == 0u) { changed[0] = 1u; } barrier(); changed[1] = subgroupAdd(1u); }",
        // All read the same word of shared memory.
        "void main() { slots[lane()] = 1u; barrier(); uint end = slots[3]; for (uint i = 0u; i < end; i++) { barrier(); } }",
        // The function as a whole stands under a condition of lanes, its own way out does not.
        "uint read(uint kind, uint at) { if (kind == 1u) { return given[2u * at]; } return given[at]; }
         void main() {
             uint mode = MODE;
             uint x = 0u;
             if (lane() < push.n) { x = read(mode, lane()); }
             changed[0] = subgroupAdd(x);
         }",
        // Barriers with one choice of the constant, a way out of the loop with the others.
        "void main() {
             uint stage = STAGE;
             bool open = true;
             uint most = stage == 1u ? push.n : given[gl_SubgroupID];
             for (uint i = 0u; i < most; i++) {
                 if (stage == 1u) { subgroupBarrier(); }
                 open = subgroupAny(given[lane()] == i);
                 if (stage != 1u && !open) { break; }
             }
         }",
        "void main() {
             uint first = subgroupShuffle(given[lane()], 0u);
             uint longest = subgroupMax(given[lane()]);
             for (uint i = first; i < longest; i++) { changed[i] = subgroupAdd(1u); }
         }",
        // Loops that lanes leave at different times, with nothing in them that needs the others.
        "uint find(uint x) { uint i = 0u; while (i < 100u) { if (given[i] == x) { break; } i++; } return i; }
         void main() { uint at = find(lane()); barrier(); changed[0] = subgroupAdd(at); }",
        // A kernel without such operations may do as it likes.
        "uint early(uint x) { if (x > 3u) { return 1u; } return given[x]; }
         void main() { changed[gl_LocalInvocationID.x] = early(gl_LocalInvocationID.x); }",
    ];
    for body in kept {
        let found = check(body);
        assert!(found.is_empty(), "{found:#?}\n{body}");
    }
}

#[test]
fn every_committed_kernel_keeps_the_rules() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().join("spirv_cache");
    let mut kernels = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        // Shaders of the graphics pipeline have two stems.
        if let Some(stem) = name.strip_suffix(".spv").filter(|stem| !stem.contains('.')) {
            let found = violations(&path, &std::fs::read(&path).unwrap()).unwrap();
            assert!(found.is_empty(), "{stem}: {found:#?}");
            kernels += 1;
        }
    }
    assert!(kernels > 50, "{kernels} kernels");
}

#[test]
fn what_is_no_shader_is_an_error() {
    for bytes in [&b""[..], b"module", &[0; 64]] {
        assert!(violations(Path::new("broken.spv"), bytes).is_err());
    }
    let whole = compile(&format!("{HEAD}void main() {{ barrier(); }}"));
    for length in (0..whole.len()).step_by(4) {
        let _ = violations(Path::new("cut.spv"), &whole[..length]);
    }
}
