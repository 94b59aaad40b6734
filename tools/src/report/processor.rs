//! What this process uses, and the processor that it runs on.

use sysinfo::{CpuRefreshKind, ProcessRefreshKind, ProcessesToUpdate, RefreshKind, System};

/// Processor time of all threads of this process so far, seconds; `None` where the system does not tell. The steadier measure
/// of a device that is a CPU when others use it too. In nanoseconds on Linux, else as fine as the system counts
/// (milliseconds).
pub(crate) fn processor_seconds() -> Option<f64> {
    scheduled_seconds().or_else(accumulated_seconds)
}

/// From the scheduler of Linux; `None` elsewhere.
fn scheduled_seconds() -> Option<f64> {
    let mut nanoseconds = 0.0;
    for thread in std::fs::read_dir("/proc/self/task").ok()? {
        // A thread may end while the list is read.
        let Ok(text) = std::fs::read_to_string(thread.ok()?.path().join("schedstat")) else { continue };
        nanoseconds += text.split_whitespace().next()?.parse::<f64>().ok()?;
    }
    (nanoseconds > 0.0).then_some(nanoseconds * 1e-9)
}

/// From the system's list of processes.
fn accumulated_seconds() -> Option<f64> {
    let own = sysinfo::get_current_pid().ok()?;
    let mut system = System::new();
    let what = ProcessRefreshKind::nothing().with_cpu();
    system.refresh_processes_specifics(ProcessesToUpdate::Some(&[own]), false, what);
    Some(system.process(own)?.accumulated_cpu_time() as f64 * 1e-3)
}

/// The processor's name and its clock now, MHz; `None` where the system does not tell.
pub(crate) fn processor() -> (Option<String>, Option<u64>) {
    let what = RefreshKind::nothing().with_cpu(CpuRefreshKind::nothing().with_frequency());
    let system = System::new_with_specifics(what);
    let first = system.cpus().first();
    let name = first.map(|cpu| cpu.brand().trim().to_owned()).filter(|name| !name.is_empty());
    (name, first.map(sysinfo::Cpu::frequency).filter(|mhz| *mhz > 0))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use std::time::{Duration, Instant};

    #[test]
    fn both_clocks_count_the_work_that_is_done() {
        // Other tests run beside this one: both clocks count them, and neither may count less than this thread's own work.
        let clocks = [scheduled_seconds, accumulated_seconds];
        let before = clocks.map(|clock| clock());
        let start = Instant::now();
        let mut word = 1_u64;
        while clocks.iter().zip(&before).any(|(now, before)| now().zip(*before).is_some_and(|(n, b)| n < b + 0.1)) {
            (0..1_000_000).for_each(|_| word = std::hint::black_box(word.wrapping_mul(0x9E37_79B9_7F4A_7C15)));
            assert!(start.elapsed() < Duration::from_secs(60), "a clock stands still");
        }
        if let [Some(a), Some(b)] = clocks.map(|clock| clock()) {
            // Threads that have ended are in one of them only.
            assert!(a > 0.0 && b > 0.0 && a < b + 1.0, "{a} and {b}");
        }
        assert!(accumulated_seconds().is_some());
    }

    #[test]
    fn the_processor_has_a_name() {
        let (name, _) = processor();
        assert!(!name.unwrap().is_empty());
    }
}
