//! Opening a device that has proven itself.

use super::{Suite, judged, known, wanted};
use crate::error::{Error, Result};
use crate::gpu::{Gpu, GpuOptions, SelfTest};

impl Gpu {
    /// Opens a device that has passed the self-test ([`crate::self_test`]), as [`GpuOptions::self_test`] wants it. One that fails
    /// is warned of, and the next one is tried, unless the options name a device.
    ///
    /// # Errors
    /// `SelfTest` when the named device fails; `NoDevice` when none is left, with what is wrong with each; `Usage` for a name that no
    /// device has.
    pub fn new(options: &GpuOptions) -> Result<Self> {
        let (mut refused, mut reasons) = (Vec::new(), Vec::new());
        loop {
            let gpu = match Self::open_except(options, &refused) {
                Err(Error::NoDevice { reason }) if !refused.is_empty() => return Err(none_left(&reasons, &reason)),
                opened => opened?,
            };
            match prove(&gpu, options) {
                Ok(()) => {
                    if options.self_test != SelfTest::Skip {
                        gpu.trust_after(prove_use);
                    }
                    reasons.iter().for_each(|reason| log::warn!("{reason}; {} is used", gpu.info().name));
                    return Ok(gpu);
                }
                Err(error) if options.device.is_some() => return Err(error),
                Err(error) => {
                    refused.push(gpu.info().index);
                    reasons.push(format!("[{}] {error}", gpu.info().index));
                }
            }
        }
    }
}

/// Tests what is wanted at once. A device that failed at anything else that it may be used for is not taken either.
fn prove(gpu: &Gpu, options: &GpuOptions) -> Result<()> {
    if options.self_test == SelfTest::Skip {
        return Ok(());
    }
    for suite in wanted(options, gpu.info()) {
        gpu.begin_proof(suite);
        prove_use(gpu, suite)?;
    }
    let possible = Suite::ALL
        .into_iter()
        .filter(|suite| options.self_test == SelfTest::Once && (options.training || !suite.trains()));
    possible.filter_map(|suite| known(gpu.info(), options, suite)).try_for_each(|verdict| judged(verdict).map(|_| ()))
}

/// Tests a suite as the device's options want it.
fn prove_use(gpu: &Gpu, suite: Suite) -> Result<()> {
    match gpu.options().self_test {
        SelfTest::Skip => return Ok(()),
        SelfTest::Once => gpu.require_self_test(suite)?,
        SelfTest::Again => gpu.self_test(suite)?,
    };
    Ok(())
}

fn none_left(reasons: &[String], others: &str) -> Error {
    let others = if others.contains("no driver found") { Vec::new() } else { vec![others.to_owned()] };
    Error::NoDevice { reason: [reasons, &others].concat().join("; ") }
}
