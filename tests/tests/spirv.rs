//! The committed SPIR-V: every shader has a declaration, every declaration matches what the module says about itself, and
//! naga, a compiler that shares no code with the one that made it, parses and validates all of it.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use engine::gpu::capability::{REQUIREMENTS, STORAGE_BUFFERS, TRAINING_STORAGE_BUFFERS};
use engine::gpu::kernel::{Access, Binding, Element, Kernel};
use engine::gpu::reconvergence::Reconvergence;
use engine::gpu::spirv;
use engine::gpu::texels::with_texel_reads;
use rspirv::dr::Operand;
use rspirv::spirv::{Capability, ExecutionMode};
use tools::dev::spirv as task;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_path_buf()
}

#[test]
fn every_shader_has_one_declaration() {
    let files = |folder: &Path| std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    let shaders: BTreeSet<String> = files(&root().join("glsl"))
        .flat_map(|folder| files(&folder))
        .filter(|p| p.extension().is_some_and(|e| e == "comp"))
        .map(|p| p.file_stem().unwrap().to_string_lossy().into_owned())
        .collect();
    let declared: BTreeSet<String> = engine::kernels().map(|k| k.name.to_owned()).collect();
    assert_eq!(declared.len(), engine::kernels().count(), "a kernel is listed twice");
    assert_eq!(shaders, declared);
}

/// What a device must offer is what the kernels bind; all of it is storage buffers, but for images.
#[test]
fn required_storage_buffers_are_those_of_the_kernels() {
    let most =
        |kernels: &mut dyn Iterator<Item = &'static Kernel>| kernels.map(|k| k.buffers().0.len() as u32).max().unwrap();
    let training: BTreeSet<&str> = engine::train::kernels().map(|k| k.name).collect();
    assert_eq!(most(&mut engine::train::kernels()), TRAINING_STORAGE_BUFFERS);
    assert_eq!(most(&mut engine::kernels().filter(|k| !training.contains(k.name))), STORAGE_BUFFERS);
    for (count, what) in [(STORAGE_BUFFERS, true), (TRAINING_STORAGE_BUFFERS, false)] {
        let name = format!("{count} storage buffers per stage");
        assert!(REQUIREMENTS.iter().any(|r| r.name == name && r.required == what), "{name}");
    }
}

#[test]
fn naga_accepts_every_module() {
    for kernel in engine::kernels() {
        spirv::validate(kernel).unwrap_or_else(|e| panic!("{e}"));
    }
}

#[test]
fn every_module_matches_its_declaration() {
    for kernel in engine::kernels() {
        let reflection = spirv::reflect(kernel).unwrap_or_else(|e| panic!("{e}"));
        spirv::check(kernel, &reflection).unwrap_or_else(|e| panic!("{e}"));
        assert!(reflection.shared_bytes <= 32 * 1024, "{}: {} bytes shared", kernel.name, reflection.shared_bytes);
        assert!(reflection.push_bytes <= 128, "{}: {} bytes of push constants", kernel.name, reflection.push_bytes);
        println!(
            "{:16} {:6} bytes, {:2} bindings, {:5} bytes shared, {:2} bytes pushed, {} threads",
            kernel.name,
            kernel.spirv.len(),
            kernel.bindings.len(),
            reflection.shared_bytes,
            reflection.push_bytes,
            kernel.local_size
        );
    }
}

/// A copy of a declaration with one thing changed, which must be refused.
fn refused(kernel: &'static Kernel, change: impl FnOnce(&mut Kernel)) -> String {
    let mut changed = clone(kernel);
    change(&mut changed);
    match spirv::check(&changed, &spirv::reflect(kernel).unwrap()) {
        Ok(()) => panic!("{}: a wrong declaration was accepted", kernel.name),
        Err(error) => error.to_string(),
    }
}

fn clone(k: &Kernel) -> Kernel {
    Kernel {
        name: k.name,
        doc: k.doc,
        local_size: k.local_size,
        spec: k.spec,
        push: k.push,
        bindings: k.bindings,
        twin: k.twin,
        arrange: k.arrange,
        tolerance: k.tolerance,
        bytes: k.bytes,
        spirv: k.spirv,
    }
}

#[test]
fn modules_take_the_workgroup_size_of_their_pipeline() {
    let sized: Vec<_> = engine::kernels().filter(|k| k.spec.contains(&Kernel::THREADS)).collect();
    assert!(sized.len() >= 4, "{}", sized.len());
    for kernel in sized {
        let words = spirv::with_local_size(&spirv::words(kernel).unwrap(), 16);
        // A constant decorated with BuiltIn WorkgroupSize would outweigh the execution mode.
        let decorated = |w: &[u32]| w[0] == ((4 << 16) | 71) && w[2..] == [11, 25];
        assert!(!words.windows(4).any(decorated), "{}", kernel.name);
        let bytes = Box::leak(bytemuck::cast_slice::<u32, u8>(&words).to_vec().into_boxed_slice());
        let small = Kernel { local_size: 16, spirv: bytes, ..clone(kernel) };
        spirv::check(&small, &spirv::reflect(&small).unwrap()).unwrap();
    }
}

#[test]
fn wrong_declarations_are_refused() {
    for kernel in engine::kernels() {
        refused(kernel, |k| k.local_size += 1);
        refused(kernel, |k| k.bindings = &k.bindings[1..]);
        // A declared constant may be unused in the module, but none may be there that is not declared.
        if !spirv::reflect(kernel).unwrap().spec.is_empty() {
            refused(kernel, |k| k.spec = &["NOT_THERE"]);
        }
        refused(kernel, |k| k.push = &[("not_there", 0), ("nor_this", 4)]);
        let flipped: Vec<_> = kernel
            .bindings
            .iter()
            .map(|b| {
                let mut b = *b;
                b.access = if b.access == Access::Read { Access::Write } else { Access::Read };
                b
            })
            .collect();
        let flipped: &'static [_] = Vec::leak(flipped);
        refused(kernel, |k| k.bindings = flipped);
    }
}

/// What a device gets that offers reconvergence: the module with the request, in the right sections, and nothing else changed.
/// Debian's spirv-val knows the older of the two extensions.
#[test]
fn reconvergence_is_asked_for_where_there_are_subgroup_operations() {
    let requests = [
        (
            Reconvergence::SubgroupUniform,
            "SPV_KHR_subgroup_uniform_control_flow",
            ExecutionMode::SubgroupUniformControlFlowKHR,
        ),
        (Reconvergence::Maximal, "SPV_KHR_maximal_reconvergence", ExecutionMode::MaximallyReconvergesKHR),
    ];
    let mut asking = 0;
    for kernel in engine::kernels() {
        let words = spirv::words(kernel).unwrap();
        assert_eq!(Reconvergence::None.ask(words.clone()), words, "{}: a device that offers nothing", kernel.name);
        let plain = rspirv::dr::load_words(&words).unwrap();
        let subgroups = Operand::Capability(Capability::GroupNonUniform);
        let has_subgroup_operations = plain.capabilities.iter().any(|c| c.operands[0] == subgroups);
        for (offer, extension, mode) in requests {
            let asked = offer.ask(words.clone());
            assert_eq!(asked != words, has_subgroup_operations, "{}", kernel.name);
            if !has_subgroup_operations {
                continue;
            }
            let mut module = rspirv::dr::load_words(&asked).unwrap();
            let added = module.extensions.remove(0);
            assert_eq!(added.operands, [Operand::LiteralString(extension.to_owned())], "{}", kernel.name);
            let added = module.execution_modes.remove(0);
            assert_eq!(added.operands[0], plain.entry_points[0].operands[1], "{}", kernel.name);
            assert_eq!(added.operands[1], Operand::ExecutionMode(mode), "{}", kernel.name);
            assert_eq!(format!("{module:?}"), format!("{plain:?}"), "{}: the rest", kernel.name);
            if offer == Reconvergence::SubgroupUniform {
                assert_valid(kernel.name, &asked);
            }
            asking += 1;
        }
    }
    assert!(asking > 20, "{asking} requests");
}

/// What Mesa's software driver gets: valid modules that read arrays from texel buffers, from second ones what they write too.
#[test]
fn arrays_are_read_as_texels() {
    let (mut texels, mut arrays) = (0, 0);
    for kernel in engine::kernels() {
        let words = spirv::words(kernel).unwrap();
        let (same, none) = with_texel_reads(&words, kernel.bindings, 0);
        assert!(same == words && none.count() == 0, "{}: none allowed", kernel.name);
        let (all, found) = with_texel_reads(&words, kernel.bindings, 64);
        assert_valid(kernel.name, &all);
        let image = |i: &rspirv::dr::Instruction| i.class.opname == "ImageRead";
        let module = rspirv::dr::load_words(&all).unwrap();
        assert_eq!(found.count() > 0, module.all_inst_iter().any(image), "{}", kernel.name);
        for (binding, declared) in (0..).zip(kernel.bindings) {
            let about = || format!("{}: `{}` {:?}", kernel.name, declared.name, declared.access);
            let (first, second) = (found.has(binding), found.has(32 + binding));
            assert!(!first || declared.access == Access::Read, "{}", about());
            assert!(!second || declared.access == Access::Update, "{}", about());
            assert!(!(first || second) || declared.layout.is_empty(), "{} is a struct", about());
        }
        let (few, some) = with_texel_reads(&words, kernel.bindings, 2);
        assert_valid(kernel.name, &few);
        assert_eq!(some.count(), found.count().min(2), "{}", kernel.name);
        texels += found.count() as usize;
        let is_array = |b: &&Binding| {
            matches!(b.access, Access::Read | Access::Update) && b.layout.is_empty() && b.element != Element::Image
        };
        arrays += kernel.bindings.iter().filter(is_array).count();
    }
    println!("{texels} of {arrays} arrays that are read");
    assert!(texels * 10 > arrays * 9, "{texels} of {arrays}");
}

fn assert_valid(name: &str, words: &[u32]) {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytemuck::cast_slice(words)).unwrap();
    let ran = std::process::Command::new("spirv-val").args(["--target-env", "vulkan1.2"]).arg(file.path()).output();
    let ran = ran.expect("spirv-val, which ci/setup --tests installs");
    assert!(ran.status.success(), "{name}: {}", String::from_utf8_lossy(&ran.stderr));
}

#[test]
fn the_cache_is_fresh() {
    let outcome = task::check(&root()).unwrap();
    assert!(!outcome.stale, "{}", outcome.lines.join("\n"));
    let manifest = task::read_manifest(&root().join("spirv_cache/manifest.json")).unwrap();
    for kernel in engine::kernels() {
        let entry = &manifest.kernels[kernel.name];
        assert_eq!(entry.spirv_sha256, task::sha256(kernel.spirv), "{}: what is embedded", kernel.name);
    }
}
