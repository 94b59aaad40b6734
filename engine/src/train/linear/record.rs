//! Recording of the layers' dispatches.

use super::gather_gradient::{GATHER_GRADIENT, GatherGradientBuffers, GatherGradientConstants, GatherGradientPush};
use super::linear_backward_input::{LINEAR_BACKWARD_INPUT, LinearBackwardInputBuffers, LinearBackwardInputPush};
use super::linear_backward_weight::{LINEAR_BACKWARD_WEIGHT, LinearBackwardWeightBuffers, LinearBackwardWeightPush};
use super::linear_update::{
    LINEAR_UPDATE, LinearUpdateBuffers, LinearUpdateConstants, LinearUpdatePush, WEIGHTS_PER_THREAD,
};
use super::{LinearConstants, Network, Output, Shape, Stage, THREADS};
use crate::error::Result;
use crate::gpu::product::product_groups;
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::linear_forward::{self, ForwardPush, LinearForwardBuffers};

/// What the dispatches of a backward pass share.
#[derive(Debug, Clone)]
pub(in crate::train) struct Pass {
    pub(in crate::train) network: Network,
    pub(in crate::train) output: Output,
    /// The step's data.
    pub(in crate::train) step: Slice,
    /// Counters of the frame.
    pub(in crate::train) counters: Slice,
    /// Reports of numbers that are not finite.
    pub(in crate::train) status: Slice,
}

/// A dense layer applied to `rows` rows.
#[derive(Debug, Clone)]
pub(in crate::train) struct Layer {
    pub(in crate::train) stage: Stage,
    pub(in crate::train) shape: Shape,
    pub(in crate::train) relu: bool,
    pub(in crate::train) rows: u32,
    /// Starts with the first input `[rows, inputs_0]`.
    pub(in crate::train) input: Slice,
    /// Where in `input` the second input starts, in floats; 0 without one.
    pub(in crate::train) input_1_at: u32,
    /// `[rows, outputs]`.
    pub(in crate::train) output: Slice,
    /// `[rows, outputs]`, the gradient before the ReLU.
    pub(in crate::train) output_gradient: Slice,
    /// Values and moments.
    pub(in crate::train) parameters: [Slice; 3],
}

/// How the rows of a gradient are split into sums of their own.
#[derive(Debug, Clone)]
pub(in crate::train) struct Split {
    pub(in crate::train) rows_per_slice: u32,
    /// Slice of `gradient` that the first rows go to.
    pub(in crate::train) first_slice: u32,
    /// Floats from slice to slice.
    pub(in crate::train) slice_stride: u32,
    /// `[slices, slice_stride]`.
    pub(in crate::train) gradient: Slice,
}

impl Layer {
    pub(in crate::train) fn forward(&self, r: &mut Recorder) -> Result<()> {
        let Shape { inputs_0, inputs_1, outputs } = self.shape;
        let push = ForwardPush { rows: self.rows, outputs, inputs_0, inputs_1, input_1_at: self.input_1_at };
        let buffers = LinearForwardBuffers {
            layer_input: self.input.clone(),
            parameter: self.parameters[0].clone(),
            layer_output: self.output.clone(),
        };
        linear_forward::record(r, self.stage, push, self.relu, buffers)
    }

    /// Gradient towards the last input, before the ReLU of `below`, the layer that made it.
    pub(in crate::train) fn backward_input(&self, r: &mut Recorder, below: &Self) -> Result<()> {
        let Shape { inputs_0, inputs_1, outputs } = self.shape;
        let (first_input, inputs) = if inputs_1 > 0 { (inputs_0, inputs_1) } else { (0, inputs_0) };
        let weight_stride = self.shape.inputs();
        let push = LinearBackwardInputPush { rows: self.rows, outputs, inputs, weight_stride, first_input };
        let stage = push.stage(self.stage);
        let lanes = r.subgroup_size_of(&LINEAR_BACKWARD_INPUT);
        let groups = product_groups(stage.0, lanes, self.rows, inputs, 1);
        let buffers = LinearBackwardInputBuffers {
            output_gradient: self.output_gradient.clone(),
            parameter: self.parameters[0].clone(),
            layer_input: below.output.clone(),
            input_gradient: below.output_gradient.clone(),
        };
        r.dispatch(&LINEAR_BACKWARD_INPUT, LinearConstants::new(stage, lanes), push, buffers, Groups::Direct(groups))
    }

    /// Gradient of weights and bias, by slices into `split.gradient`.
    pub(in crate::train) fn backward_weight(&self, r: &mut Recorder, split: &Split) -> Result<()> {
        let Shape { inputs_0, inputs_1, outputs } = self.shape;
        let push = LinearBackwardWeightPush {
            rows: self.rows,
            outputs,
            inputs_0,
            inputs_1,
            input_1_at: self.input_1_at,
            rows_per_slice: split.rows_per_slice,
            first_slice: split.first_slice,
            slice_stride: split.slice_stride,
        };
        let slices = self.rows.div_ceil(split.rows_per_slice);
        let stage = push.stage(self.stage);
        let lanes = r.subgroup_size_of(&LINEAR_BACKWARD_WEIGHT);
        let groups = product_groups(stage.0, lanes, outputs, self.shape.inputs(), slices);
        let buffers = LinearBackwardWeightBuffers {
            output_gradient: self.output_gradient.clone(),
            layer_input: self.input.clone(),
            gradient: split.gradient.clone(),
        };
        r.dispatch(&LINEAR_BACKWARD_WEIGHT, LinearConstants::new(stage, lanes), push, buffers, Groups::Direct(groups))
    }
}

impl Pass {
    /// Sum of slices of a gradient `from`, into Adam of `parameters` (values and moments) and their `mean` where there is one, or
    /// into `gradient` where it is to be kept.
    pub(in crate::train) fn update(
        &self,
        r: &mut Recorder,
        push: LinearUpdatePush,
        from: Slice,
        parameters: [Slice; 3],
        mean: Option<Slice>,
        gradient: Option<Slice>,
    ) -> Result<()> {
        let [parameter, moment_1, moment_2] = parameters;
        let with_mean = mean.is_some().into();
        let buffers = LinearUpdateBuffers {
            step: self.step.clone(),
            counters: self.counters.clone(),
            slice_gradient: from,
            parameter,
            moment_1,
            moment_2,
            gradient,
            mean,
            status: self.status.clone(),
        };
        let constants =
            LinearUpdateConstants { output: self.output as u32, network: self.network as u32, mean: with_mean };
        let groups = Groups::Direct(push.weights.div_ceil(THREADS * WEIGHTS_PER_THREAD).into());
        r.dispatch(&LINEAR_UPDATE, constants, push, buffers, groups)
    }

    /// `push.rows` rows of the planes of a head's gradient, 8 columns for F and 12 for G.
    pub(in crate::train) fn gather(
        &self,
        r: &mut Recorder,
        push: GatherGradientPush,
        planes: &Slice,
        rows: &Slice,
    ) -> Result<()> {
        let columns = match self.network {
            Network::F => 8,
            Network::G => 12,
        };
        let groups = Groups::Direct((u64::from(push.rows) * columns).div_ceil(THREADS.into()));
        let constants = GatherGradientConstants { network: self.network as u32 };
        let buffers =
            GatherGradientBuffers { plane: planes.clone(), row_gradient: rows.clone(), status: self.status.clone() };
        r.dispatch(&GATHER_GRADIENT, constants, push, buffers, groups)
    }
}
