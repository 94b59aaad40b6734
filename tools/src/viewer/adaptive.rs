//! Adaptive resolution: while something moves and frames are slow, fewer pixels are rendered; a picture that stands still has all
//! of them. Levels are eighths, so that it settles; a change costs nothing, buffers and commands have room for all of them.

/// A frame that takes longer is slow, seconds.
const SLOW_S: f64 = 1.0 / 12.0;
/// Slow frames in a row before a level is given up.
const SLOW_FRAMES: u32 = 2;
/// Quick frames in a row before a level is taken back.
const QUICK_FRAMES: u32 = 10;
/// Full resolution.
const FULL: u32 = 8;
/// Half of the width and height: below, what does not depend on pixels is most of a frame.
const LEAST: u32 = 4;

/// The share of the resolution that keeps frames quick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Adaptive {
    eighths: u32,
    slow: u32,
    quick: u32,
}

impl Adaptive {
    pub(super) fn new() -> Self {
        Self { eighths: FULL, slow: 0, quick: 0 }
    }

    /// Share of the width and of the height, 0.5 to 1.
    pub(super) fn share(self) -> f32 {
        self.eighths as f32 / FULL as f32
    }

    /// Learns what a frame of this resolution took, seconds.
    pub(super) fn frame(&mut self, seconds: f64) {
        // What the next level would take if pixels were all that counts: the most that it can take.
        let growth = (f64::from(self.eighths + 1) / f64::from(self.eighths)).powi(2);
        self.slow = if seconds > SLOW_S { self.slow + 1 } else { 0 };
        self.quick = if seconds * growth < 0.9 * SLOW_S { self.quick + 1 } else { 0 };
        if self.slow >= SLOW_FRAMES && self.eighths > LEAST {
            *self = Self { eighths: self.eighths - 1, ..Self::new() };
        } else if self.quick >= QUICK_FRAMES && self.eighths < FULL {
            *self = Self { eighths: self.eighths + 1, ..Self::new() };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs until it has settled; what a frame of full resolution takes, of which a part does not depend on pixels.
    fn settled(pixels_s: f64, rest_s: f64) -> (Adaptive, f64) {
        let mut adaptive = Adaptive::new();
        let time = |a: Adaptive| rest_s + pixels_s * f64::from(a.share()).powi(2);
        for _ in 0..200 {
            adaptive.frame(time(adaptive));
        }
        (adaptive, time(adaptive))
    }

    #[test]
    fn quick_frames_keep_all_pixels() {
        assert_eq!(settled(0.01, 0.005).0.share(), 1.0);
        assert_eq!(settled(0.06, 0.005).0.share(), 1.0);
    }

    #[test]
    fn slow_frames_give_up_pixels_until_they_are_quick_and_no_more() {
        let (adaptive, time) = settled(0.2, 0.01);
        assert!(time <= SLOW_S && time > 0.5 * SLOW_S && adaptive.share() < 1.0, "{adaptive:?} {time}");
        assert_eq!(settled(9.0, 9.0).0.share(), 0.5);
    }

    #[test]
    fn it_settles_and_recovers() {
        let (mut adaptive, time) = settled(0.1, 0.02);
        let share = adaptive.share();
        (0..100).for_each(|_| adaptive.frame(time));
        assert_eq!(adaptive.share(), share, "no swinging");
        (0..200).for_each(|_| adaptive.frame(0.001));
        assert_eq!(adaptive.share(), 1.0);
        // One hitch is no reason.
        adaptive.frame(1.0);
        adaptive.frame(0.001);
        assert_eq!(adaptive.share(), 1.0);
    }
}
