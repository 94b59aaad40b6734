//! What is never right, and the exceptions with their reasons.

use super::{Row, Target};

/// A kernel that may have fewer subgroups in flight than the floor.
#[derive(Debug, Clone, Copy)]
pub struct Exception {
    /// Targets whose name begins so.
    pub target: &'static str,
    /// The kernel.
    pub kernel: &'static str,
    /// Fewest that are accepted.
    pub floor: f64,
    /// Why.
    pub why: &'static str,
}

/// The exceptions.
pub const EXCEPTIONS: &[Exception] = &[];

/// Constants that have one value in the program: kernel, constant.
const ONE_VALUE: &[(&str, &str)] = &[];

/// The exception that a pipeline comes under, by its place in [`EXCEPTIONS`].
pub fn exception(target: &Target, row: &Row) -> Option<usize> {
    EXCEPTIONS.iter().position(|e| target.name.starts_with(e.target) && row.kernel == e.kernel)
}

/// Whether the program gives a constant of a kernel but one value: what it could be besides is for tests.
pub fn one_value(kernel: &str, constant: &str) -> bool {
    ONE_VALUE.contains(&(kernel, constant))
}

/// What is wrong with a pipeline, whatever the golden file says.
pub fn broken(target: &Target, row: &Row) -> Option<String> {
    let s = &row.statistics;
    let name = row.name();
    if s.spills > 0.0 {
        return Some(format!("{}: {name} spills {} registers, expected none", target.name, s.spills));
    }
    if s.scratch > 0.0 {
        return Some(format!(
            "{}: {name} keeps {} bytes in memory per invocation, expected none",
            target.name, s.scratch
        ));
    }
    let floor = exception(target, row).map_or(target.floor, |i| EXCEPTIONS[i].floor);
    (s.occupancy < floor)
        .then(|| format!("{}: {name} has {} subgroups in flight, expected at least {floor}", target.name, s.occupancy))
}
