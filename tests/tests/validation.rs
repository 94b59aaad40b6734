//! Canaries: faults that the validation layer must report. When one falls silent, a clean run proves nothing any more.
//! (A write-after-write hazard is not among them: the layer misses it, our own tracker does not; see `hazards.rs`.)

use engine::gpu::{Buffer, Gpu, GpuOptions, Groups, Memory, Recorder, Slice};
use engine::render::sort_histogram::{SORT_HISTOGRAM, SortHistogramBuffers, SortHistogramPush};

const BYTES: u64 = 64 * 1024;
const PUSH: SortHistogramPush = SortHistogramPush { shift: 0, digit_bits: 8, count_word: 0, partition_shift: 12 };

struct Probe {
    gpu: Gpu,
    counters: Buffer,
    a: Buffer,
    b: Buffer,
}

impl Probe {
    fn options() -> GpuOptions {
        GpuOptions { validation: true, breadcrumbs: false, pipeline_cache: false, ..GpuOptions::default() }
    }

    fn new() -> Self {
        Self::with(Self::options())
    }

    fn with(options: GpuOptions) -> Self {
        let gpu = Gpu::open(&options).unwrap();
        let buffer = |name| gpu.buffer(name, BYTES, Memory::Device).unwrap();
        let (a, b) = (buffer("a"), buffer("b"));
        // 4096 keys: one partition, one histogram row.
        let counters = gpu.buffer_with("counters", bytemuck::cast_slice(&[4096_u32; 8])).unwrap();
        for buffer in [&a, &b] {
            gpu.upload(buffer, &vec![0; BYTES as usize]).unwrap();
        }
        assert!(gpu.take_validation_messages().is_empty());
        Self { gpu, counters, a, b }
    }

    /// Reads `keys`, writes `histogram`.
    fn dispatch(&self, recorder: &mut Recorder, keys: &Buffer, histogram: &Buffer, groups: Groups) {
        let [counters, keys, histogram] = [&self.counters, keys, histogram].map(Slice::from);
        let buffers = SortHistogramBuffers { counters, keys, histogram };
        recorder.dispatch(&SORT_HISTOGRAM, (), PUSH, buffers, groups).unwrap();
    }

    /// Runs the recording as it is, then without the barrier before its last operation: clean first, reported then.
    fn assert_missing_barrier_is_reported(&self, record: impl Fn(&mut Recorder), fault: &str) {
        let mut good = self.gpu.recorder("good");
        record(&mut good);
        self.gpu.run(good).unwrap();
        assert_eq!(self.gpu.take_validation_messages(), Vec::<String>::new(), "control of {fault}");
        let mut bad = self.gpu.recorder("bad");
        record(&mut bad);
        assert!(bad.omit_barrier(bad.len() - 1), "{fault}: our tracker derived no barrier");
        self.gpu.run(bad).unwrap();
        let messages = self.gpu.take_validation_messages();
        assert!(messages.iter().any(|m| m.contains("SYNC-HAZARD")), "the layer missed {fault}: {messages:?}");
    }
}

#[test]
fn read_after_write_between_dispatches() {
    let p = Probe::new();
    let record = |r: &mut Recorder| {
        p.dispatch(r, &p.a, &p.b, Groups::Direct(1));
        p.dispatch(r, &p.b, &p.a, Groups::Direct(1));
    };
    p.assert_missing_barrier_is_reported(record, "read after write");
}

#[test]
fn write_after_read_between_dispatches() {
    let p = Probe::new();
    let c = p.gpu.buffer("c", BYTES, Memory::Device).unwrap();
    let record = |r: &mut Recorder| {
        p.dispatch(r, &p.a, &p.b, Groups::Direct(1));
        p.dispatch(r, &c, &p.a, Groups::Direct(1));
    };
    p.assert_missing_barrier_is_reported(record, "write after read");
}

#[test]
fn fill_then_shader_read() {
    let p = Probe::new();
    let record = |r: &mut Recorder| {
        r.fill(&p.a, 0).unwrap();
        p.dispatch(r, &p.a, &p.b, Groups::Direct(1));
    };
    p.assert_missing_barrier_is_reported(record, "fill then read");
}

#[test]
fn indirect_arguments_after_shader_write() {
    let p = Probe::new();
    let c = p.gpu.buffer("c", BYTES, Memory::Device).unwrap();
    let record = |r: &mut Recorder| {
        p.dispatch(r, &p.a, &p.b, Groups::Direct(1));
        p.dispatch(r, &p.a, &c, Groups::Indirect(p.b.clone(), 4096));
    };
    p.assert_missing_barrier_is_reported(record, "indirect arguments");
}

/// Settings of the layer come from the environment of a process, so this canary runs in a child.
fn in_child(test: &str, enables: &str) {
    let output = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", test, "--nocapture"])
        .env("VK_LAYER_ENABLES", enables)
        .env("SPGS_CANARY_CHILD", "1")
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && text.contains("canary reported"), "{text}");
}

fn is_child() -> bool {
    std::env::var_os("SPGS_CANARY_CHILD").is_some()
}

#[test]
fn read_after_write_across_submissions() {
    if !is_child() {
        let queue_submit = "VALIDATION_CHECK_ENABLE_SYNCHRONIZATION_VALIDATION_QUEUE_SUBMIT";
        return in_child("read_after_write_across_submissions", queue_submit);
    }
    let p = Probe::new();
    let mut first = p.gpu.recorder("first");
    p.dispatch(&mut first, &p.a, &p.b, Groups::Direct(1));
    let mut second = p.gpu.recorder("second");
    p.dispatch(&mut second, &p.b, &p.a, Groups::Direct(1));
    assert!(second.omit_barrier(usize::MAX), "no barrier at the beginning");
    let (mut first, mut second) = (first.finish().unwrap(), second.finish().unwrap());
    p.gpu.submit(&mut first).unwrap();
    let last = p.gpu.submit(&mut second).unwrap();
    p.gpu.wait(last).unwrap();
    let messages = p.gpu.take_validation_messages();
    assert!(messages.iter().any(|m| m.contains("SYNC-HAZARD")), "{messages:?}");
    println!("canary reported: {}", messages[0]);
}

/// The buffer itself must be too small: this layer does not look at the descriptor's range.
#[test]
fn write_past_the_end_of_a_buffer() {
    let p = Probe::with(GpuOptions { gpu_assisted: true, ..Probe::options() });
    let mut recorder = p.gpu.recorder("out of bounds");
    let buffers = SortHistogramBuffers {
        counters: p.counters.whole(),
        keys: p.a.whole(),
        histogram: p.gpu.buffer("small", 256, Memory::Device).unwrap().whole(),
    };
    recorder.dispatch(&SORT_HISTOGRAM, (), PUSH, buffers, Groups::Direct(1)).unwrap();
    p.gpu.run(recorder).unwrap();
    p.gpu.wait_idle().unwrap();
    let messages = p.gpu.take_validation_messages();
    assert!(messages.iter().any(|m| m.to_lowercase().contains("out of bounds")), "{messages:?}");
}
