//! Photos that a run does not train on until its beginnings have been compared: on photos that both have seen, the one that learns by
//! heart looks better.

use super::config::Config;
use super::schedule::Stage;

/// One of so many photos is kept aside.
const EVERY: usize = 8;
/// Fewer say too little.
const FEWEST: usize = 2;

/// Which photos are kept aside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct KeptAside {
    photos: usize,
    /// The last iteration without them; 0: none are kept aside.
    until: u64,
}

/// Iterations by which the window of the other beginning is open: two thirds of the trial.
pub(super) fn trial_window(config: &Config) -> u64 {
    config.schedule.window_trial * 2 / 3
}

impl KeptAside {
    /// Of the photos of a run with this configuration, as it is given, up to the trial; both of its beginnings have the same. None
    /// where no trial follows.
    pub(super) fn of(config: &Config, stage: Stage, photos: usize) -> Self {
        let (s, opens) = (&config.schedule, trial_window(config));
        let compared = stage == Stage::Rigid && opens > s.warm_up && [0, opens].contains(&s.time_window);
        Self::new(photos, if compared { config.scaled().schedule.window_trial } else { 0 })
    }

    /// Of so many photos, up to an iteration.
    pub(super) const fn new(photos: usize, until: u64) -> Self {
        Self { photos, until: if photos / EVERY < FEWEST { 0 } else { until } }
    }

    /// Whether a photo is kept aside.
    pub(super) fn has(&self, photo: usize) -> bool {
        self.until > 0 && photo % EVERY == EVERY / 2
    }

    /// All of them.
    pub(super) fn photos(self) -> impl Iterator<Item = usize> {
        (0..self.photos).filter(move |photo| self.has(*photo))
    }

    /// The photo that takes part at `iteration` where this one was drawn: the next, while it is kept aside.
    pub(super) fn in_place_of(&self, photo: usize, iteration: u64) -> usize {
        if iteration <= self.until && self.has(photo) { (photo + 1) % self.photos } else { photo }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::config::Preset;

    #[test]
    fn one_photo_of_eight_waits_for_its_iteration() {
        let k = KeptAside::new(21, 100);
        assert_eq!(k.photos().collect::<Vec<_>>(), [4, 12, 20]);
        assert_eq!([3, 4, 5, 20].map(|photo| k.in_place_of(photo, 100)), [3, 5, 5, 0]);
        assert_eq!([3, 4, 5, 20].map(|photo| k.in_place_of(photo, 101)), [3, 4, 5, 20]);
    }

    #[test]
    fn photos_are_kept_aside_only_where_beginnings_are_compared() {
        let aside = |iterations: u64, stage: Stage, warm_up: u64, time_window: u64| {
            let mut config = Preset::Dnerf.best();
            config.iterations = iterations;
            (config.schedule.warm_up, config.schedule.time_window) = (warm_up, time_window);
            KeptAside::of(&config, stage, 100).until
        };
        let opens = trial_window(&Preset::Dnerf.best());
        // However long the run, its other beginning keeps the same photos aside, as long.
        for iterations in [40_000, 6000, 2000, 777, 12_345] {
            let trial = aside(iterations, Stage::Rigid, 3000, 0);
            assert!(trial > 0 && trial.abs_diff(iterations / 4) <= 1, "{trial}");
            assert_eq!(aside(iterations, Stage::Rigid, 3000, opens), trial);
            // A window that was asked for; a trial that ends before motion begins; a run without motion.
            assert_eq!(aside(iterations, Stage::Rigid, 3000, 20_000), 0);
            assert_eq!([aside(iterations, Stage::Rigid, 9000, 0), aside(iterations, Stage::Static, 3000, 0)], [0, 0]);
        }
    }

    #[test]
    fn of_few_photos_none_is_kept_aside() {
        for k in [KeptAside::new(15, 100), KeptAside::new(100, 0), KeptAside::new(0, 100)] {
            assert_eq!((k.photos().count(), k.in_place_of(4, 1)), (0, 4));
        }
        assert_eq!(KeptAside::new(16, 100).photos().count(), 2);
    }
}
