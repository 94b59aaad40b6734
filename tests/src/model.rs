//! The executable model of subgroups in place of the device. `SPGS_TEST_MODEL=32` (4 to 128 lanes) makes every
//! [`KernelCase`](crate::KernelCase) run on it, in an order that `SPGS_TEST_MODEL_SEED` chooses (0 if not set). The kernel tests then show races
//! and divergent barriers, and hold at subgroup sizes that no software driver has.
//!
//! `SPGS_TEST_MODEL_MODE` is a list of: `wide-barriers` (a subgroup barrier waits for the workgroup, as in newer lavapipe),
//! `any-order` (invocations belong to subgroups in any order). `SPGS_TEST_MODEL_LOG=FILE` collects which kernels ran, for the
//! test that none is forgotten.

use std::collections::{BTreeSet, HashMap};
use std::io::Write as _;
use std::sync::{Arc, Mutex, PoisonError};

use engine::gpu::kernel::{Element, Kernel};
use engine::gpu::proof::{KernelCase, KernelResult};
use engine::gpu::spirv;
pub use model::{Dispatch, ModelError, Options, Program};

use crate::planted;

/// What the environment asks for.
///
/// # Panics
/// When a variable is wrong.
pub fn options() -> Option<Options> {
    let number = |name: &str| {
        let text = std::env::var(name).ok()?;
        Some(text.parse::<u64>().unwrap_or_else(|_| panic!("{name}={text} is no number")))
    };
    let lanes = number("SPGS_TEST_MODEL")?;
    let mut options = Options::new(lanes as u32, number("SPGS_TEST_MODEL_SEED").unwrap_or(0));
    for mode in std::env::var("SPGS_TEST_MODEL_MODE").unwrap_or_default().split(',').filter(|m| !m.is_empty()) {
        match mode {
            "wide-barriers" => options.subgroup_barrier_is_workgroup = true,
            "any-order" => options.shuffle_invocations = true,
            _ => panic!("SPGS_TEST_MODEL_MODE: `{mode}`, expected wide-barriers or any-order"),
        }
    }
    Some(options)
}

type Programs = HashMap<(&'static str, Vec<u32>), Arc<Program>>;
static PROGRAMS: Mutex<Option<Programs>> = Mutex::new(None);

/// The program of a case; read once for each set of constants.
fn program(case: &KernelCase, lanes: u32) -> Arc<Program> {
    let spec = [&[lanes], &case.spec[..]].concat();
    let key = (case.kernel.name, spec);
    let mut programs = PROGRAMS.lock().unwrap_or_else(PoisonError::into_inner);
    let programs = programs.get_or_insert_default();
    if let Some(found) = programs.get(&key) {
        return found.clone();
    }
    log(case.kernel, lanes);
    let words = sized(case.kernel, &key.1);
    let made = Program::new(&words, &key.1).unwrap_or_else(|error| panic!("{}: {error}", case.kernel.name));
    programs.entry(key).or_insert(Arc::new(made)).clone()
}

/// The module, with as many threads as the constants ask for.
fn sized(kernel: &Kernel, spec: &[u32]) -> Vec<u32> {
    let (words, threads) = (planted::words(kernel), kernel.threads(spec));
    if threads == kernel.local_size { words } else { spirv::with_local_size(&words, threads) }
}

/// Runs a case on the model, and its twin.
///
/// # Panics
/// When the model finds an error.
pub fn run_beside_twin(mut case: KernelCase, options: &Options) -> KernelResult {
    case.poison();
    let result = run(&case, options);
    case.with_twin(options.lanes, result)
}

/// Runs a case on the model; the buffers after it.
///
/// # Panics
/// When the model finds an error.
pub fn run(case: &KernelCase, options: &Options) -> Vec<Vec<u32>> {
    try_run(case, options).unwrap_or_else(|error| panic!("{} on the model, {options:?}: {error}", case.kernel.name))
}

/// [`run`] that tells what is wrong.
///
/// # Errors
/// What the model finds.
pub fn try_run(case: &KernelCase, options: &Options) -> Result<Vec<Vec<u32>>, ModelError> {
    run_program(&program(case, options.lanes), case, options)
}

/// Runs another program, such as an edited kernel, with the inputs of a case. An image is as wide as the frame of binding 0
/// says.
///
/// # Errors
/// What the model finds.
pub fn run_program(program: &Program, case: &KernelCase, options: &Options) -> Result<Vec<Vec<u32>>, ModelError> {
    let mut buffers = case.buffers.clone();
    let has_image = case.kernel.bindings.iter().any(|b| b.element == Element::Image);
    let image_width = if has_image { buffers[0][FRAME_WIDTH] } else { 0 };
    let mut dispatch = Dispatch { groups: [case.groups, 1, 1], push: &case.push, buffers: &mut buffers, image_width };
    program.run(&mut dispatch, options)?;
    Ok(buffers)
}

/// Word of `Frame::size`'s first component.
const FRAME_WIDTH: usize = 32;

/// Operations of SPIR-V by which invocations meet: barriers and all of subgroups.
fn meets(op: u32) -> bool {
    matches!(op, 224 | 225 | 333..=366)
}

/// Words of each instruction of a module.
pub fn instructions(words: &[u32]) -> impl Iterator<Item = (usize, &[u32])> {
    let mut at = 5;
    std::iter::from_fn(move || {
        let first = *words.get(at)?;
        let start = at;
        at += (first >> 16).max(1) as usize;
        Some((start, words.get(start..at)?))
    })
}

/// Kernels in which invocations meet, or that have shared memory.
///
/// # Panics
/// When a kernel's SPIR-V is no module.
pub fn kernels_that_meet() -> BTreeSet<&'static str> {
    const VARIABLE: u32 = 59;
    const WORKGROUP: u32 = 4;
    let meet = |kernel: &&Kernel| {
        let words = engine::gpu::spirv::words(kernel).unwrap();
        instructions(&words)
            .any(|(_, i)| meets(i[0] & 0xffff) || (i[0] & 0xffff == VARIABLE && i.get(3) == Some(&WORKGROUP)))
    };
    engine::kernels().filter(meet).map(|k| k.name).collect()
}

fn log(kernel: &Kernel, lanes: u32) {
    if let Some(path) = std::env::var_os("SPGS_TEST_MODEL_LOG") {
        let mut file = std::fs::OpenOptions::new().append(true).create(true).open(path).unwrap();
        writeln!(file, "{lanes} {}", kernel.name).unwrap();
    }
}
