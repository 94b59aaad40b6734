//! The two networks as data: slices of (pool, convolutions); the output of each slice is one feature map.

/// Which network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub enum Network {
    /// AlexNet (torchvision's, one tower).
    Alex,
    /// VGG-16, maps after relu1_2, 2_2, 3_3, 4_3 and 5_3.
    Vgg,
}

/// A convolution followed by ReLU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Conv {
    /// Index in torchvision's `features`.
    pub(super) layer: usize,
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    /// Side of the window.
    pub(super) kernel: usize,
    pub(super) stride: usize,
    /// Zeros around the picture.
    pub(super) pad: usize,
}

/// What leads to a feature map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Slice {
    /// Max pool before the convolutions: side of the window; its stride is 2.
    pub(super) pool: Option<usize>,
    pub(super) convs: &'static [Conv],
}

/// Stride of every max pool.
pub(super) const POOL_STRIDE: usize = 2;

const fn conv3(layer: usize, inputs: usize, outputs: usize) -> Conv {
    Conv { layer, inputs, outputs, kernel: 3, stride: 1, pad: 1 }
}

const ALEX: [Slice; 5] = [
    Slice { pool: None, convs: &[Conv { layer: 0, inputs: 3, outputs: 64, kernel: 11, stride: 4, pad: 2 }] },
    Slice { pool: Some(3), convs: &[Conv { layer: 3, inputs: 64, outputs: 192, kernel: 5, stride: 1, pad: 2 }] },
    Slice { pool: Some(3), convs: &[conv3(6, 192, 384)] },
    Slice { pool: None, convs: &[conv3(8, 384, 256)] },
    Slice { pool: None, convs: &[conv3(10, 256, 256)] },
];

const VGG: [Slice; 5] = [
    Slice { pool: None, convs: &[conv3(0, 3, 64), conv3(2, 64, 64)] },
    Slice { pool: Some(2), convs: &[conv3(5, 64, 128), conv3(7, 128, 128)] },
    Slice { pool: Some(2), convs: &[conv3(10, 128, 256), conv3(12, 256, 256), conv3(14, 256, 256)] },
    Slice { pool: Some(2), convs: &[conv3(17, 256, 512), conv3(19, 512, 512), conv3(21, 512, 512)] },
    Slice { pool: Some(2), convs: &[conv3(24, 512, 512), conv3(26, 512, 512), conv3(28, 512, 512)] },
];

impl Network {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Alex, Self::Vgg];

    /// `alex` or `vgg`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Alex => "alex",
            Self::Vgg => "vgg",
        }
    }

    pub(super) fn slices(self) -> &'static [Slice; 5] {
        match self {
            Self::Alex => &ALEX,
            Self::Vgg => &VGG,
        }
    }

    /// Smallest picture side that every pool leaves a pixel of.
    pub fn smallest_side(self) -> usize {
        match self {
            Self::Alex => 31,
            Self::Vgg => 16,
        }
    }
}

impl Conv {
    /// Side of the output.
    pub(super) fn output_side(&self, side: usize) -> usize {
        (side + 2 * self.pad).saturating_sub(self.kernel) / self.stride + 1
    }

    /// Products in each output value.
    pub(super) fn depth(&self) -> usize {
        self.inputs * self.kernel * self.kernel
    }
}

/// Side after a max pool.
pub(super) fn pooled_side(side: usize, kernel: usize) -> usize {
    side.saturating_sub(kernel) / POOL_STRIDE + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_fit_and_the_smallest_picture_leaves_a_pixel() {
        for network in Network::ALL {
            let fits = |side: usize| {
                let mut side = side;
                network.slices().iter().all(|slice| {
                    let pooled = slice.pool.is_none_or(|k| {
                        let enough = side >= k;
                        side = pooled_side(side, k);
                        enough
                    });
                    pooled
                        && slice.convs.iter().all(|c| {
                            let enough = side + 2 * c.pad >= c.kernel;
                            side = c.output_side(side);
                            enough
                        })
                })
            };
            assert!(fits(network.smallest_side()) && !fits(network.smallest_side() - 1), "{network:?}");
            let convs: Vec<&Conv> = network.slices().iter().flat_map(|s| s.convs).collect();
            assert!(convs.windows(2).all(|w| w[0].outputs == w[1].inputs));
        }
    }
}
