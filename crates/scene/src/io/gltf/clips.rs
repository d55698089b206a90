//! Clips of a glTF file: decoded on request, sampled at any time (glTF 2.0 appendix C).

use super::accessor::Document;
use super::json::Place;
use crate::io::SceneError;
use crate::rig::Skeleton;
use crate::{Asset, Motion, Pose, Source};
use glam::{DQuat, DVec3};

/// Longest clip that is resampled [frames].
const MAX_FRAMES: f64 = 1e6;

/// An animation of the file, for the joints of its skeleton.
#[derive(Clone, Debug)]
pub struct Clip {
    /// Name in the file, or `clip_N`.
    pub name: String,
    /// Time of the last key [s].
    pub duration: f64,
    /// Whether it also animates morph weights or nodes that move no vertex, which a [`Pose`] does not hold.
    pub has_other_channels: bool,
    channels: Vec<Channel>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Target {
    Translation,
    Rotation,
    Scale,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Interpolation {
    Linear,
    Step,
    CubicSpline,
}

#[derive(Clone, Debug)]
struct Channel {
    joint: usize,
    target: Target,
    interpolation: Interpolation,
    /// Key times [s], strictly increasing.
    times: Vec<f64>,
    /// Values \[key\], for splines \[key\]\[in-tangent, value, out-tangent\]; the fourth number is 0 but for rotations.
    values: Vec<[f64; 4]>,
}

/// All clips of an asset; none for assets that are not glTF.
///
/// # Errors
/// [`SceneError::Invalid`] with the JSON pointer where an animation breaks the rules.
pub fn clips(asset: &Asset) -> Result<Vec<Clip>, SceneError> {
    let Source::Gltf { json, buffers } = &asset.source else { return Ok(Vec::new()) };
    let document = Document::new(json, buffers)?;
    let animations = document.root.list("animations")?;
    animations.iter().enumerate().map(|(i, a)| clip(&document, &asset.rig.skeleton, i, a)).collect()
}

fn clip(document: &Document, skeleton: &Skeleton, index: usize, animation: &Place) -> Result<Clip, SceneError> {
    let name = match animation.text("name") {
        "" => format!("clip_{index}"),
        name => name.to_string(),
    };
    let mut clip = Clip { name, duration: 0.0, has_other_channels: false, channels: Vec::new() };
    let samplers = animation.list("samplers")?;
    for place in animation.list("channels")? {
        let target = place.need("target")?;
        let node = target.get("node").map(|n| n.usize()).transpose()?;
        let joint = node.and_then(|n| skeleton.joints.iter().position(|j| j.node == Some(n)));
        let path = match target.text("path") {
            "translation" => Some(Target::Translation),
            "rotation" => Some(Target::Rotation),
            "scale" => Some(Target::Scale),
            _ => None,
        };
        let (Some(joint), Some(path)) = (joint, path) else {
            clip.has_other_channels = true;
            continue;
        };
        let sampler = place.need("sampler")?;
        let which = sampler.usize()?;
        let source = samplers.get(which).ok_or_else(|| {
            sampler.invalid(format!("refers to sampler {which}, but the animation has {}", samplers.len()))
        })?;
        let channel = channel(document, source, joint, path)?;
        clip.duration = channel.times.last().map_or(clip.duration, |t| t.max(clip.duration));
        clip.channels.push(channel);
    }
    Ok(clip)
}

fn channel(document: &Document, sampler: &Place, joint: usize, target: Target) -> Result<Channel, SceneError> {
    let interpolation = match sampler.text("interpolation") {
        "STEP" => Interpolation::Step,
        "CUBICSPLINE" => Interpolation::CubicSpline,
        _ => Interpolation::Linear,
    };
    let (input, output) = (sampler.need("input")?, sampler.need("output")?);
    let times = document.numbers(&input)?;
    if times.width != 1 || times.values.is_empty() {
        return Err(input.invalid("should hold at least one key time"));
    }
    if times.values.windows(2).any(|w| w[0] >= w[1]) || times.values.iter().any(|t| !t.is_finite()) {
        return Err(input.invalid("key times should increase strictly"));
    }
    let numbers = document.numbers(&output)?;
    let width = if target == Target::Rotation { 4 } else { 3 };
    let needed = times.values.len() * if interpolation == Interpolation::CubicSpline { 3 } else { 1 };
    if numbers.width != width || numbers.count() != needed || numbers.values.iter().any(|x| !x.is_finite()) {
        let what = format!(
            "should hold {needed} finite values of {width} numbers, holds {} of {}",
            numbers.count(),
            numbers.width
        );
        return Err(output.invalid(what));
    }
    let values = numbers.rows().map(|r| [r[0], r[1], r[2], r.get(3).copied().unwrap_or(0.0)]).collect();
    Ok(Channel { joint, target, interpolation, times: times.values, values })
}

impl Channel {
    fn at(&self, time: f64) -> [f64; 4] {
        let n = self.times.len();
        let after = self.times.partition_point(|&t| t <= time);
        let value = |key: usize| match self.interpolation {
            Interpolation::CubicSpline => self.values[3 * key + 1],
            _ => self.values[key],
        };
        if after == 0 || after == n {
            return value(if after == 0 { 0 } else { n - 1 });
        }
        let (a, b) = (after - 1, after);
        let span = self.times[b] - self.times[a];
        let u = (time - self.times[a]) / span;
        match self.interpolation {
            Interpolation::Step => value(a),
            Interpolation::Linear if self.target == Target::Rotation => slerp(value(a), value(b), u),
            Interpolation::Linear => std::array::from_fn(|i| value(a)[i] + u * (value(b)[i] - value(a)[i])),
            Interpolation::CubicSpline => {
                let (out, arrive) = (self.values[3 * a + 2], self.values[3 * b]);
                let (u2, u3) = (u * u, u * u * u);
                std::array::from_fn(|i| {
                    (2.0 * u3 - 3.0 * u2 + 1.0) * value(a)[i]
                        + span * (u3 - 2.0 * u2 + u) * out[i]
                        + (-2.0 * u3 + 3.0 * u2) * value(b)[i]
                        + span * (u3 - u2) * arrive[i]
                })
            }
        }
    }
}

fn slerp(a: [f64; 4], b: [f64; 4], u: f64) -> [f64; 4] {
    let unit = |q: [f64; 4]| rotation(q).unwrap_or(DQuat::IDENTITY);
    unit(a).slerp(unit(b), u).to_array()
}

fn rotation(q: [f64; 4]) -> Option<DQuat> {
    let q = DQuat::from_array(q);
    (q.length() > 1e-9).then(|| q.normalize())
}

impl Clip {
    /// The pose at `time` [s]; before the first and after the last key the nearest key holds.
    pub fn pose(&self, skeleton: &Skeleton, time: f64) -> Pose {
        let mut locals = skeleton.rest_locals();
        for channel in &self.channels {
            let v = channel.at(time);
            let local = &mut locals[channel.joint];
            match channel.target {
                Target::Translation => local.translation = DVec3::new(v[0], v[1], v[2]),
                Target::Rotation => local.rotation = rotation(v).unwrap_or(local.rotation),
                Target::Scale => local.scale = DVec3::new(v[0], v[1], v[2]),
            }
        }
        Pose { locals }
    }

    /// The clip resampled at `fps` from time 0 to its end.
    ///
    /// # Errors
    /// [`SceneError::Caller`] if `fps` is not positive, [`SceneError::Limit`] if that gives more than a million frames.
    pub fn motion(&self, skeleton: &Skeleton, fps: f64) -> Result<Motion, SceneError> {
        if !(fps > 0.0 && fps.is_finite()) {
            return Err(SceneError::Caller(format!("{fps} frames per second")));
        }
        // A key on the last frame counts although its time was rounded to f32.
        let last = (self.duration.max(0.0) * fps + 1e-3).floor();
        if last >= MAX_FRAMES {
            return Err(SceneError::limit(&self.name, format!("{last} frames, more than {MAX_FRAMES}")));
        }
        let poses = (0..=last as usize).map(|k| self.pose(skeleton, k as f64 / fps)).collect();
        Ok(Motion { name: self.name.clone(), fps, poses })
    }
}
