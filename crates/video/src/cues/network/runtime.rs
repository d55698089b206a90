//! Runs networks with `rten`: pure Rust, on the CPU.

use super::resample::resampled;
use super::wire::operators;
use super::{Network, Plane};
use crate::error::{Result, VideoError};
use crate::quiet::catch_quietly;
use animimic_scene::Image;
use rten::{Dimension, Model, RunOptions, ThreadPool, Value};
use rten_tensor::prelude::*;
use std::panic::AssertUnwindSafe;
use std::path::Path;
use std::sync::Arc;

/// Largest file: more does not fit into a protocol buffer [bytes].
const MAX_BYTES: u64 = 2 << 30;
/// Largest picture side that a network may ask for or give [px].
const MAX_SIDE: usize = 4096;
/// Operators of networks in integers, of which the runtime was seen to compute some wrongly without a word.
const INTEGER_OPERATORS: [&str; 8] = [
    "QuantizeLinear",
    "DequantizeLinear",
    "DynamicQuantizeLinear",
    "QLinearConv",
    "QLinearMatMul",
    "QLinearAdd",
    "ConvInteger",
    "MatMulInteger",
];

/// The first output for every frame, in order.
pub fn run(network: &Network, frames: &[Image]) -> Result<Vec<Plane>> {
    let model = load(&network.file)?;
    let fixed = input_size(&network.file, &model)?;
    // The runtime's own pool would not heed the number of threads that was asked for.
    let pool = Arc::new(ThreadPool::with_num_threads(rayon::current_num_threads()));
    let options = RunOptions::default().with_thread_pool(Some(pool));
    let one = |frame: &Image| -> Result<Plane> {
        let size = fixed.unwrap_or_else(|| network.preset.size((frame.width, frame.height)));
        let shape = [1, 3, size.1, size.0];
        let input = Value::from_shape(shape, fed(network, frame, size)).expect("three planes of that size");
        let work = AssertUnwindSafe(|| model.run_one(input.into(), Some(options.clone())));
        let out = match catch_quietly(work) {
            Ok(Ok(out)) => out,
            Ok(Err(e)) => {
                return Err(invalid(
                    &network.file,
                    format!("the network fails on a {}x{} picture: {}", size.0, size.1, line(&e)),
                ));
            }
            Err(()) => {
                return Err(invalid(&network.file, "the network cannot be run: the runtime gave up on it".into()));
            }
        };
        plane(network, out)
    };
    frames.iter().map(one).collect()
}

fn invalid(path: &Path, reason: String) -> VideoError {
    VideoError::invalid(path, reason)
}

/// An error's words on one line.
fn line(error: &impl std::fmt::Display) -> String {
    error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}

fn load(file: &Path) -> Result<Model> {
    let about = std::fs::metadata(file).map_err(VideoError::io(file))?;
    if about.is_dir() {
        return Err(invalid(file, "a folder; name the .onnx file in it".into()));
    }
    if about.len() > MAX_BYTES {
        return Err(VideoError::Limit { path: file.into(), reason: "over 2 GiB: use a smaller network".into() });
    }
    let bytes = std::fs::read(file).map_err(VideoError::io(file))?;
    if bytes.starts_with(b"version https://git-lfs") {
        return Err(invalid(
            file,
            "a Git LFS pointer, not the network itself; run `git lfs pull` where it came from".into(),
        ));
    }
    let Some(operators) = operators(&bytes) else {
        return Err(invalid(file, "not an ONNX network, or a part of one: copy or export it again".into()));
    };
    if let Some(operator) = INTEGER_OPERATORS.into_iter().find(|o| operators.contains(&o.as_bytes())) {
        let what = format!("a network in integers ({operator}); use the one in floating point that it was made from");
        return Err(invalid(file, what));
    }
    match catch_quietly(AssertUnwindSafe(|| Model::load(bytes))) {
        Ok(Ok(model)) => Ok(model),
        Ok(Err(e)) => {
            let what = format!(
                "not an ONNX network that can be run: {}; export it again, as one file with its weights",
                line(&e)
            );
            Err(invalid(file, what))
        }
        Err(()) => Err(invalid(file, "not an ONNX network that can be run: it is broken; export it again".into())),
    }
}

/// The size (width, height) that the file fixes; `None` where it leaves both open.
fn input_size(file: &Path, model: &Model) -> Result<Option<(usize, usize)>> {
    let count = model.input_ids().len();
    if count != 1 || model.output_ids().is_empty() {
        let what =
            format!("{count} inputs and {} outputs; a network of one picture is needed", model.output_ids().len());
        return Err(invalid(file, what));
    }
    let shape = model.input_shape(0).unwrap_or_else(|| vec![Dimension::Symbolic(String::new()); 4]);
    let wrong = || {
        let words = shape.iter().map(|d| match d {
            Dimension::Fixed(n) => n.to_string(),
            Dimension::Symbolic(_) => "?".into(),
        });
        let words = words.collect::<Vec<_>>().join(",");
        invalid(file, format!("it takes [{words}]; a network of [1,3,H,W] is needed: one picture, channels first"))
    };
    let fits = |d: &Dimension, n: usize| matches!(d, Dimension::Symbolic(_)) || *d == Dimension::Fixed(n);
    let [batch, channels, height, width] = &shape[..] else { return Err(wrong()) };
    if !fits(batch, 1) || !fits(channels, 3) {
        return Err(wrong());
    }
    match (width, height) {
        (&Dimension::Fixed(w), &Dimension::Fixed(h)) if (1..=MAX_SIDE).contains(&w) && (1..=MAX_SIDE).contains(&h) => {
            Ok(Some((w, h)))
        }
        (Dimension::Symbolic(_), Dimension::Symbolic(_)) => Ok(None),
        _ => Err(wrong()),
    }
}

/// A frame as the network's family takes it: three planes, one after the other.
fn fed(network: &Network, frame: &Image, size: (usize, usize)) -> Vec<f32> {
    let preset = network.preset;
    let channel = |c: usize| {
        let values: Vec<f32> = frame.rgb.iter().map(|p| f32::from(p[c]) / 255.0).collect();
        let at_size = resampled(&values, (frame.width, frame.height), size);
        at_size.into_iter().map(move |v| (v - preset.mean[c]) / preset.deviation[c])
    };
    (0..3).flat_map(channel).collect()
}

/// The picture in an output: all axes but two have length 1.
fn plane(network: &Network, out: Value) -> Result<Plane> {
    let (file, gives) = (&network.file, network.preset.gives.word());
    let shape = out.shape().to_vec();
    let wrong = || invalid(file, format!("it gives {shape:?}: for {gives} one picture [1,1,H,W] of floats is needed"));
    let mut sides: Vec<usize> = shape.clone();
    while sides.len() > 2 {
        let Some(one) = sides.iter().position(|&n| n == 1) else { return Err(wrong()) };
        sides.remove(one);
    }
    let &[height, width] = &sides[..] else { return Err(wrong()) };
    let sound = |n: usize| (2..=MAX_SIDE).contains(&n);
    let Some(tensor) = out.into_tensor::<f32>().filter(|_| sound(width) && sound(height)) else { return Err(wrong()) };
    let values = tensor.into_data();
    if !values.iter().all(|v| v.is_finite()) {
        let what = "it gives values that are not finite: is it of another family? Name its preset, as onnx:FILE:PRESET";
        return Err(invalid(file, what.into()));
    }
    Ok(Plane { width, height, values })
}
