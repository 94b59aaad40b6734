//! How the paper measures on each of its data sets, and how a run differs from that.

use engine::metrics::lpips::Network;
use serde::Serialize;

use crate::cli::args::SplitArg;
use crate::report::benchmark::Benchmark;

/// The paper's protocol for a data set.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Protocol {
    /// Data set.
    pub(super) benchmark: Benchmark,
    /// Colour behind the scene.
    pub(super) background: [f32; 3],
    /// Picture size, if the paper states it.
    pub(super) size: Option<[u32; 2]>,
    /// LPIPS network of the table per scene, if the paper or its code states it.
    pub(super) lpips: Option<Network>,
    /// The similarity of the table per scene.
    pub(super) similarity: &'static str,
    /// Which views are test views.
    pub(super) split: &'static str,
    /// What to know when comparing with the table.
    pub(super) remarks: Vec<&'static str>,
}

/// The protocol of a data set.
pub(super) fn of(benchmark: Benchmark) -> Protocol {
    let protocol = |size, lpips, split, remarks| Protocol {
        benchmark,
        background: [0.0; 3],
        size,
        lpips,
        similarity: benchmark.similarity(),
        split,
        remarks,
    };
    match benchmark {
        Benchmark::DNerf => protocol(
            Some([800, 800]),
            Some(Network::Alex),
            "transforms_test.json",
            vec![
                "The means of the paper leave Lego out, whose test views disagree with its training views: report \
                  --split val beside it.",
            ],
        ),
        Benchmark::HyperNerf => protocol(
            Some([536, 960]),
            None,
            "val_ids of dataset.json (vrig)",
            vec![
                "The paper does not name the LPIPS network of this table; the code computes both.",
                "MS-SSIM of the paper's code leaves the data range to each image; here it is 1.",
            ],
        ),
        Benchmark::NerfDs => protocol(
            Some([480, 270]),
            Some(Network::Vgg),
            "val_ids of dataset.json",
            vec![
                "The similarity column is called SSIM in the main table and MS-SSIM in the table per scene.",
                "MS-SSIM of the paper's code leaves the data range to each image; here it is 1.",
            ],
        ),
        Benchmark::Nvidia => protocol(
            None,
            None,
            "not stated in the paper; here the data set's rule",
            vec![
                "Neither split, nor size, nor LPIPS network of this table are stated, and the published code has no \
                  loader for this data set.",
            ],
        ),
    }
}

impl Protocol {
    /// What of a run is not as in the paper; one line each.
    pub(super) fn deviations(&self, split: SplitArg, size: [u32; 2], background: [f32; 3]) -> Vec<String> {
        let mut lines = Vec::new();
        if split != SplitArg::Test {
            lines.push(format!("split {}; the paper has the test split", split.name()));
        }
        let turned = |[w, h]: [u32; 2]| [h, w];
        if let Some(paper) = self.size.filter(|s| *s != size && turned(*s) != size) {
            lines.push(format!("images of {}x{}; the paper has {}x{}", size[0], size[1], paper[0], paper[1]));
        }
        if background != self.background {
            lines.push(format!("background {background:?}; the paper has {:?}", self.background));
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviations_are_named() {
        let p = of(Benchmark::DNerf);
        assert!(p.deviations(SplitArg::Test, [800, 800], [0.0; 3]).is_empty());
        assert_eq!(p.deviations(SplitArg::Val, [400, 400], [1.0; 3]).len(), 3);
        assert!(of(Benchmark::NerfDs).deviations(SplitArg::Test, [270, 480], [0.0; 3]).is_empty());
    }
}
