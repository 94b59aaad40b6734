//! How long frames take: frames per second, the slowest hundredth, and a history of the stages. Fixed memory.

/// Frames that are remembered.
const FRAMES: usize = 1000;
/// Frames of the graph.
pub(super) const HISTORY: usize = 160;
/// Seconds over which frames per second are counted.
const WINDOW_S: f64 = 1.0;

/// Parts of a frame, in its order.
pub(super) const STAGES: [&str; 3] = ["project, tile lists", "sort tiles", "blend"];

/// Which stage an operation of the frame belongs to.
pub(super) fn stage_of(label: &str) -> usize {
    let found = [
        ("deform", 0),
        ("nonrigid", 0),
        ("field", 0),
        ("linear", 0),
        ("fill", 0),
        ("scan", 0),
        ("emit", 0),
        ("sort", 1),
    ];
    found.iter().find(|(start, _)| label.starts_with(start)).map_or(2, |(_, stage)| *stage)
}

/// Device milliseconds of each stage of one frame.
pub(super) type StageTimes = [f32; STAGES.len()];

/// What is known about the latest frames.
#[derive(Debug, Clone)]
pub(super) struct Statistics {
    seconds: [f32; FRAMES],
    count: usize,
    stages: [StageTimes; HISTORY],
    stage_count: usize,
}

impl Default for Statistics {
    fn default() -> Self {
        Self { seconds: [0.0; FRAMES], count: 0, stages: [[0.0; STAGES.len()]; HISTORY], stage_count: 0 }
    }
}

impl Statistics {
    /// A frame took so long, from its start to the start of the next.
    pub(super) fn frame(&mut self, seconds: f64) {
        self.seconds[self.count % FRAMES] = seconds as f32;
        self.count += 1;
    }

    pub(super) fn stages(&mut self, times: StageTimes) {
        self.stages[self.stage_count % HISTORY] = times;
        self.stage_count += 1;
    }

    fn latest(&self) -> impl Iterator<Item = f64> {
        let known = self.count.min(FRAMES);
        (1..=known).map(|back| f64::from(self.seconds[(self.count - back) % FRAMES]))
    }

    /// Frames per second over the last second.
    pub(super) fn fps(&self) -> Option<f64> {
        let (mut sum, mut frames) = (0.0, 0);
        for seconds in self.latest() {
            sum += seconds;
            frames += 1;
            if sum >= WINDOW_S {
                break;
            }
        }
        (sum > 0.0).then(|| f64::from(frames) / sum)
    }

    /// Frames per second of the slowest hundredth of the last thousand frames.
    pub(super) fn low_fps(&self) -> Option<f64> {
        let known = self.count.min(FRAMES);
        if known < 2 {
            return None;
        }
        let mut sorted = self.seconds;
        sorted[..known].sort_unstable_by(|a, b| b.total_cmp(a));
        let slowest = known.div_ceil(100);
        let sum: f64 = sorted[..slowest].iter().map(|s| f64::from(*s)).sum();
        (sum > 0.0).then(|| slowest as f64 / sum)
    }

    /// Stage times, oldest first.
    pub(super) fn history(&self) -> impl Iterator<Item = &StageTimes> {
        let known = self.stage_count.min(HISTORY);
        (self.stage_count - known..self.stage_count).map(|i| &self.stages[i % HISTORY])
    }

    /// Mean stage times of the last frames.
    pub(super) fn mean_stages(&self) -> StageTimes {
        let mut sum = [0.0; STAGES.len()];
        let mut n = 0.0;
        for times in self.history() {
            sum.iter_mut().zip(times).for_each(|(s, t)| *s += t);
            n += 1.0;
        }
        sum.map(|s| if n > 0.0 { s / n } else { 0.0 })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn rates_are_those_of_the_frames() {
        let mut s = Statistics::default();
        assert_eq!((s.fps(), s.low_fps()), (None, None));
        (0..3000).for_each(|i| s.frame(if i % 100 == 50 { 0.1 } else { 0.01 }));
        assert!((s.fps().unwrap() - 92.0).abs() < 3.0, "{:?}", s.fps());
        assert!((s.low_fps().unwrap() - 10.0).abs() < 1e-3);
        s.frame(1.5);
        assert!((s.fps().unwrap() - 1.0 / 1.5).abs() < 1e-6);
    }

    #[test]
    fn every_operation_has_its_stage() {
        let expected =
            [("deform_project", 0), ("scan_tiles", 0), ("emit_tiles", 0), ("sort_tiles long", 1), ("blend", 2)];
        expected.iter().for_each(|(label, stage)| assert_eq!(stage_of(label), *stage, "{label}"));
        let mut s = Statistics::default();
        (0..HISTORY + 5).for_each(|i| s.stages([i as f32; 3]));
        assert_eq!(s.history().count(), HISTORY);
        assert_eq!(s.history().next().unwrap()[0], 5.0);
    }
}
