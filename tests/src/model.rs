//! The executable model of subgroups in place of the device: `SPGS_TEST_MODEL=32` (4 to 128 lanes) makes every
//! [`KernelCase`] run on it, with the order of `SPGS_TEST_MODEL_SEED` (0 if not set). The kernel tests then show races and
//! divergent barriers, and hold at subgroup sizes that no software driver has.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

pub use model::{Dispatch, ModelError, Options, Program};

use crate::KernelCase;

/// What the environment asks for.
///
/// # Panics
/// When a variable is no number.
pub fn options() -> Option<Options> {
    let number = |name: &str| {
        let text = std::env::var(name).ok()?;
        Some(text.parse::<u64>().unwrap_or_else(|_| panic!("{name}={text} is no number")))
    };
    let lanes = number("SPGS_TEST_MODEL")?;
    Some(Options::new(lanes as u32, number("SPGS_TEST_MODEL_SEED").unwrap_or(0)))
}

/// `all` on the device, only `few` on the model, which is slower.
pub fn fewer<T>(all: T, few: T) -> T {
    if options().is_some() { few } else { all }
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
    let words = engine::gpu::spirv::words(case.kernel).unwrap();
    let made = Program::new(&words, &key.1).unwrap_or_else(|error| panic!("{}: {error}", case.kernel.name));
    programs.entry(key).or_insert(Arc::new(made)).clone()
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
    let mut buffers = case.buffers.clone();
    let mut dispatch =
        Dispatch { groups: [case.groups, 1, 1], push: &case.push, buffers: &mut buffers, image_width: 0 };
    program(case, options.lanes).run(&mut dispatch, options)?;
    Ok(buffers)
}
