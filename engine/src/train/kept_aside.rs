//! Photos that a run does not train on until its beginnings have been compared: on photos that both have seen, the one that learns by
//! heart looks better.

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

impl KeptAside {
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

    #[test]
    fn one_photo_of_eight_waits_for_its_iteration() {
        let k = KeptAside::new(21, 100);
        assert_eq!(k.photos().collect::<Vec<_>>(), [4, 12, 20]);
        assert_eq!([3, 4, 5, 20].map(|photo| k.in_place_of(photo, 100)), [3, 5, 5, 0]);
        assert_eq!([3, 4, 5, 20].map(|photo| k.in_place_of(photo, 101)), [3, 4, 5, 20]);
    }

    #[test]
    fn of_few_photos_none_is_kept_aside() {
        for k in [KeptAside::new(15, 100), KeptAside::new(100, 0), KeptAside::new(0, 100)] {
            assert_eq!((k.photos().count(), k.in_place_of(4, 1)), (0, 4));
        }
        assert_eq!(KeptAside::new(16, 100).photos().count(), 2);
    }
}
