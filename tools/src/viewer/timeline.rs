//! Playing time: what is shown now, how fast it runs, what happens at the ends.

/// Seconds that the whole range takes at speed 1.
const WHOLE_S: f64 = 3.0;
/// Steps of the arrow keys over the range.
const STEPS: f64 = 100.0;

/// What happens at the end of the range.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Repeat {
    /// From the start again.
    #[default]
    Loop,
    /// Back and forth.
    PingPong,
    /// Stops.
    Once,
}

impl Repeat {
    pub(super) fn next(self) -> Self {
        match self {
            Self::Loop => Self::PingPong,
            Self::PingPong => Self::Once,
            Self::Once => Self::Loop,
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Loop => "loop",
            Self::PingPong => "ping-pong",
            Self::Once => "once",
        }
    }
}

/// The time of the scene.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Timeline {
    /// First and last time; equal for a scene that stands still.
    pub(super) range: [f64; 2],
    pub(super) time: f64,
    pub(super) playing: bool,
    /// 1: the range takes three seconds.
    pub(super) speed: f64,
    pub(super) repeat: Repeat,
    backwards: bool,
}

impl Timeline {
    pub(super) fn new(range: [f64; 2]) -> Self {
        let moves = range[1] > range[0];
        Self { range, time: range[0], playing: moves, speed: 1.0, repeat: Repeat::Loop, backwards: false }
    }

    pub(super) fn moves(&self) -> bool {
        self.range[1] > self.range[0]
    }

    fn length(&self) -> f64 {
        self.range[1] - self.range[0]
    }

    /// Lets `dt` seconds pass; true when the time changed.
    pub(super) fn advance(&mut self, dt: f64) -> bool {
        if !self.playing || !self.moves() {
            return false;
        }
        let step = dt * self.speed / WHOLE_S * self.length();
        let [start, end] = self.range;
        // Only back and forth goes back.
        self.backwards &= self.repeat == Repeat::PingPong;
        let wanted = self.time + if self.backwards { -step } else { step };
        self.time = match self.repeat {
            Repeat::Loop => start + (wanted - start).rem_euclid(self.length()),
            Repeat::Once => {
                self.playing = wanted < end;
                wanted.clamp(start, end)
            }
            Repeat::PingPong => self.bounce(wanted),
        };
        true
    }

    fn bounce(&mut self, wanted: f64) -> f64 {
        let [start, end] = self.range;
        let phase = (wanted - start).rem_euclid(2.0 * self.length());
        let outside = wanted < start || wanted > end;
        self.backwards ^= outside;
        if phase <= self.length() { start + phase } else { end - (phase - self.length()) }
    }

    /// Starts or stops; at the end of a time that runs once, from the start.
    pub(super) fn toggle(&mut self) {
        if !self.playing && self.repeat == Repeat::Once && self.time >= self.range[1] {
            self.time = self.range[0];
        }
        self.playing = !self.playing && self.moves();
    }

    /// Stops and goes on by hundredths of the range, within it.
    pub(super) fn step(&mut self, steps: f64) {
        self.playing = false;
        self.seek(self.time + steps * self.length() / STEPS);
    }

    pub(super) fn seek(&mut self, time: f64) {
        self.time = time.clamp(self.range[0], self.range[1]);
    }

    /// Doubles or halves the speed, between 1/64 and 64.
    pub(super) fn faster(&mut self, factor: f64) {
        self.speed = (self.speed * factor).clamp(1.0 / 64.0, 64.0);
    }

    /// Takes the range of another model; the time and the rest stay where they can.
    pub(super) fn set_range(&mut self, range: [f64; 2]) {
        let stood = !self.moves();
        self.range = range;
        self.playing = self.moves() && (self.playing || stood);
        self.seek(self.time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_wraps_and_ping_pong_turns_round() {
        let mut t = Timeline::new([2.0, 5.0]);
        assert!(t.playing && t.advance(1.0) && (t.time - 3.0).abs() < 1e-12);
        t.advance(2.5);
        assert!((t.time - 2.5).abs() < 1e-12);
        t.repeat = Repeat::PingPong;
        t.advance(3.0);
        assert!((t.time - 4.5).abs() < 1e-12, "{}", t.time);
        t.advance(1.0);
        assert!((t.time - 3.5).abs() < 1e-12, "{}", t.time);
        t.advance(2.0);
        assert!((t.time - 2.5).abs() < 1e-12, "{}", t.time);
    }

    #[test]
    fn once_stops_at_the_end_and_starts_again() {
        let mut t = Timeline::new([0.0, 1.0]);
        t.repeat = Repeat::Once;
        t.advance(10.0);
        assert!(t.time == 1.0 && !t.playing && !t.advance(1.0));
        t.toggle();
        assert!(t.playing && t.time == 0.0);
    }

    #[test]
    fn only_back_and_forth_goes_back() {
        for repeat in [Repeat::Once, Repeat::Loop] {
            let mut t = Timeline::new([0.0, 1.0]);
            t.repeat = Repeat::PingPong;
            t.advance(4.0);
            assert!((t.time - 2.0 / 3.0).abs() < 1e-12, "{}", t.time);
            t.repeat = repeat;
            t.advance(0.5);
            assert!((t.time - 5.0 / 6.0).abs() < 1e-12, "{repeat:?}: {}", t.time);
            t.advance(5.0);
            assert!((0.0..=1.0).contains(&t.time), "{repeat:?}: {}", t.time);
            assert_eq!(t.playing, repeat == Repeat::Loop);
        }
    }

    #[test]
    fn what_stands_still_never_plays() {
        let mut t = Timeline::new([0.0, 0.0]);
        t.toggle();
        assert!(!t.playing && !t.advance(1.0));
        t.step(3.0);
        assert_eq!(t.time, 0.0);
        t.set_range([0.0, 1.0]);
        assert!(t.playing);
    }

    #[test]
    fn steps_and_speeds_stay_in_bounds() {
        let mut t = Timeline::new([0.0, 1.0]);
        t.step(1.0);
        assert!(!t.playing && (t.time - 0.01).abs() < 1e-12);
        t.step(-5.0);
        assert_eq!(t.time, 0.0);
        (0..20).for_each(|_| t.faster(2.0));
        assert_eq!(t.speed, 64.0);
        t.time = 0.9;
        t.set_range([0.0, 0.5]);
        assert_eq!(t.time, 0.5);
    }
}
