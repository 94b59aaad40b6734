//! When devices were lost.

use std::time::{Duration, Instant};

/// So many losses in so short a time end the program: the next device would be lost too.
const MOST: usize = 3;
const WITHIN: Duration = Duration::from_secs(60);
/// When devices were lost.
#[derive(Debug, Default)]
pub(super) struct Losses {
    /// The latest ones but this one, in turns.
    latest: [Option<Instant>; MOST - 1],
    pub(super) count: usize,
}

impl Losses {
    /// Notes one; false when it is one too many.
    pub(super) fn note(&mut self, now: Instant) -> bool {
        let place = self.count % self.latest.len();
        let before = self.latest[place].replace(now);
        self.count += 1;
        before.is_none_or(|at| now.duration_since(at) > WITHIN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_third_loss_within_a_minute_is_one_too_many() {
        let start = Instant::now();
        let after = |seconds: &[u64]| {
            let mut losses = Losses::default();
            seconds.iter().map(|s| losses.note(start + Duration::from_secs(*s))).collect::<Vec<_>>()
        };
        assert_eq!(after(&[0, 1, 2]), [true, true, false]);
        assert_eq!(after(&[0, 50, 61, 70, 140]), [true, true, true, false, true]);
        assert_eq!(after(&[0, 100, 200, 300]), [true; 4]);
    }
}
