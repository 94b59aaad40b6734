//! Whether the subgroup and workgroup operations of a compute shader sit in flow that is uniform for their scope, read from
//! its SPIR-V.
//!
//! A barrier that not all invocations reach together, or a ballot in a branch that only some lanes take, is undefined: one
//! driver does what was meant, the next makes garbage or hangs. The layers do not see it. The rules:
//!
//! 1. A barrier, of whatever scope, needs flow that is uniform for the workgroup: some drivers make a barrier of the whole
//!    workgroup of a subgroup's.
//! 2. A subgroup operation (`OpGroupNonUniform…`) needs flow that is uniform for the subgroup.
//! 3. In a shader with such operations no function returns from within flow that is not uniform for the workgroup: where its
//!    invocations meet again is left to the compiler.
//! 4. Such a shader numbers its invocations in one way: by subgroup and lane, or by `gl_LocalInvocationID`. How the one follows
//!    from the other is left to the driver.
//!
//! The analysis is that of compilers (divergence by data and control dependence), on the module as it is committed: functions
//! are expanded at their calls (`flatten`), constants are folded for one choice of the specialisation constants in `CASES`
//! (`constants`), control dependence follows from post-dominance on what can then be reached (`graph`), and each value is
//! uniform for the workgroup, for the subgroup, or divergent (`levels`). Specialisation constants that are not chosen are
//! unknown but uniform, so what holds, holds for all of their values. Shared memory is taken to be free of races.

mod assigned;
mod constants;
mod flatten;
mod fold;
mod graph;
mod levels;
mod module;
mod operations;
mod rules;

use std::collections::BTreeMap;
use std::path::Path;

use engine::error::{Error, Result};
use module::Module;

/// Specialisation constants whose values choose between ways of sharing that obey the rules in different ways, by name.
const CASES: &[(&str, &[u32])] = &[("STAGE", &[0, 1, 2])];

/// Breaches of the rules in one SPIR-V module, one line each: what, where, which branch. Empty: it keeps them.
///
/// # Errors
/// `Corrupt` when it is no SPIR-V that can be analysed; `path` is named then.
pub fn violations(path: &Path, spirv: &[u8]) -> Result<Vec<String>> {
    let module = Module::parse(spirv).map_err(|why| malformed(path, why))?;
    let program = flatten::flatten(&module).map_err(|why| malformed(path, why))?;
    let mut cases_of: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let chosen = CASES.iter().find(|(name, _)| module.specialisation(name).is_some());
    for value in chosen.map_or(&[][..], |(_, values)| values) {
        let (name, _) = chosen.unwrap_or(&CASES[0]);
        let fixed = module.specialisation(name).map(|id| (id, *value));
        for line in rules::breaches(&module, &program, fixed) {
            cases_of.entry(line).or_default().push(format!("{name} = {value}"));
        }
    }
    if chosen.is_none() {
        cases_of.extend(rules::breaches(&module, &program, None).into_iter().map(|line| (line, Vec::new())));
    }
    let describe = |(line, cases): (String, Vec<String>)| match cases.as_slice() {
        [] => line,
        some => format!("{line} ({})", some.join(", ")),
    };
    Ok(cases_of.into_iter().map(describe).collect())
}

fn malformed(path: &Path, why: String) -> Error {
    Error::corrupt(path, "SPIR-V", why, "a compute shader")
}
