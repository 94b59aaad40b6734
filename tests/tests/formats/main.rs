//! Files of other programs: real ones against an independent decoder, round trips, training runs, hostile bytes, the
//! command line.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod checkpoints;
mod convert;
mod convert_bake;
mod convert_refusals;
mod distill;
mod edit;
mod fields;
mod fuzz;
mod hostile;
mod pickle;
mod real;
mod round_trips;
