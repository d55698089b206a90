//! What is given: maps of the base slots in every frame, vertices with their targets; and the state of a solve.

use super::INFLUENCES;
use super::spaces::Spaces;
use animimic_scene::{Influence, Mesh, Refined, Rig, Trajectory};
use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;
use std::borrow::Cow;
use std::ops::Range;

/// What the displayed rest counts, as a share of all frames of clips together.
const REST_SHARE: f64 = 0.05;
/// Blends of rest maps that shrink volumes below this share of the maps' own cannot be inverted well: the vertex stays where it is stored.
const LEAST_VOLUME: f64 = 0.2;

/// The base rig in all frames. Frame 0 is the displayed rest, then come the frames of each clip.
pub struct Problem<'a> {
    /// M_k,f: world from vertex buffer, \[frame\]\[slot\].
    pub maps: Vec<Vec<DAffine3>>,
    /// G_j,f: world from joint, \[frame\]\[joint\].
    pub world: Vec<Vec<DAffine3>>,
    /// Target vertices \[frame\]\[vertex of the file\].
    pub targets: Vec<&'a [DVec3]>,
    /// ω_f \[frame\], summing to 1.
    pub counts: Vec<f64>,
    /// The frames of each clip among all.
    pub clips: Vec<Range<usize>>,
    /// Joints of the base rig.
    pub joints: usize,
    /// Length of the rest diagonal [model unit].
    pub diagonal: f64,
    /// Spaces of the vertex buffers.
    pub spaces: Spaces,
    /// Displayed rest \[vertex\].
    pub rest: &'a [DVec3],
    /// Stored positions \[vertex\].
    pub stored: &'a [DVec3],
    /// Base influences \[vertex\].
    pub base: &'a [Vec<Influence>],
    /// The first vertex of each welded one that the base skin does not bring to its targets.
    pub active: Vec<usize>,
    joint_of: Vec<usize>,
}

/// A new joint, while it is sought.
#[derive(Clone, Debug)]
pub struct Helper {
    /// The joint that it is born on: its rest map and what it follows where vertices say nothing.
    pub joint: usize,
    /// A_h: displayed rest from vertex buffer \[group\]; `None` where the group cannot be moved by it.
    pub rest: Vec<Option<DAffine3>>,
    /// D_h,f: rigid displacement \[frame\].
    pub moved: Vec<DAffine3>,
    /// Middle of its points at rest [model unit].
    pub centre: DVec3,
    /// Root mean square distance of its points from there [model unit].
    pub spread: f64,
}

/// A vertex in a solve. Influences name slots, helpers behind the base slots.
#[derive(Clone, Debug)]
pub struct Point {
    /// Vertex of the file.
    pub vertex: usize,
    /// Group of its slots.
    pub group: usize,
    /// Position in the vertex buffer; moved only where the displayed rest is not the bind pose.
    pub stored: DVec3,
    /// Present influences.
    pub influences: Vec<Influence>,
    /// What each frame counts beside ω_f \[frame\]; 1 where empty.
    pub emphasis: Vec<f64>,
}

impl Point {
    /// ω_f of this point.
    pub fn count(&self, problem: &Problem, frame: usize) -> f64 {
        problem.counts[frame] * self.emphasis_in(frame)
    }

    /// What a frame counts beside ω_f.
    pub fn emphasis_in(&self, frame: usize) -> f64 {
        self.emphasis.get(frame).copied().unwrap_or(1.0)
    }

    /// Counts frames in which the point is more than about `goal` [model unit] off for more, as in iteratively reweighted least squares
    /// for the fourth power (Lawson 1961); half of the way in logarithms, so that it settles.
    pub fn emphasise(&mut self, problem: &Problem, helpers: &[Helper], goal: f64) {
        let wanted = |f: usize| 1.0 + problem.missing(helpers, self, f).length_squared() / (goal * goal);
        let wanted: Vec<f64> = (0..problem.targets.len()).map(wanted).collect();
        self.emphasis.resize(wanted.len(), 1.0);
        self.emphasis.iter_mut().zip(wanted).for_each(|(e, w)| *e = (*e * w).sqrt());
    }
}

/// Vertices under work.
#[derive(Clone)]
pub struct State {
    /// The vertices.
    pub points: Vec<Point>,
}

/// Errors over the points and frames of a state [model unit].
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// Root mean square.
    pub rms: f64,
    /// 99th percentile.
    pub p99: f64,
}

impl<'a> Problem<'a> {
    /// Gathers what is given; vertices that come within `negligible` [model unit] of all targets are not active.
    pub fn new(
        rig: &'a Rig,
        mesh: &'a Mesh,
        clips: &[Refined],
        surfaces: &'a [Cow<'a, Trajectory>],
        negligible: f64,
    ) -> Self {
        let rest = rig.skeleton.rest_locals();
        let poses = std::iter::once(&rest).chain(clips.iter().flat_map(|c| c.motion.poses.iter().map(|p| &p.locals)));
        let world: Vec<Vec<DAffine3>> = poses.map(|locals| rig.skeleton.world_from_joint(locals)).collect();
        let slots = &rig.skin.slots;
        let maps = world.iter().map(|w| slots.iter().map(|s| w[s.joint] * s.inverse_bind).collect()).collect();
        let targets: Vec<&[DVec3]> = std::iter::once(&mesh.positions)
            .chain(surfaces.iter().flat_map(|s| &s.frames))
            .map(Vec::as_slice)
            .collect();
        let frames = targets.len() as f64 - 1.0;
        let mut counts = vec![(1.0 - REST_SHARE) / frames.max(1.0); targets.len()];
        counts[0] = REST_SHARE;
        let mut at = 1;
        let ranges = clips.iter().map(|c| {
            at += c.motion.poses.len();
            at - c.motion.poses.len()..at
        });
        let mut problem = Self {
            clips: ranges.collect(),
            maps,
            world,
            targets,
            counts,
            joints: rig.skeleton.joints.len(),
            diagonal: mesh.diagonal(),
            spaces: Spaces::new(rig, mesh),
            rest: &mesh.positions,
            stored: &rig.skin.bind_positions,
            base: &rig.skin.influences,
            active: Vec::new(),
            joint_of: slots.iter().map(|s| s.joint).collect(),
        };
        let leaves = |&v: &usize| {
            let place = |f: usize| skinned(&problem, v, f);
            (1..problem.targets.len()).any(|f| place(f).distance(problem.targets[f][v]) > negligible)
        };
        problem.active = first_of_welded(mesh).into_par_iter().filter(leaves).collect();
        problem
    }

    /// Number of base slots; slot numbers from here on are helpers.
    pub fn slots(&self) -> usize {
        self.joint_of.len()
    }

    /// Joint of a base slot.
    pub fn joint_of(&self, slot: u32) -> usize {
        self.joint_of[slot as usize]
    }

    /// A vertex as it stands in the file.
    pub fn point(&self, vertex: usize) -> Point {
        let influences = self.base[vertex].clone();
        let group = self.spaces.group_of[influences[0].slot as usize];
        Point { vertex, group, stored: self.stored[vertex], influences, emphasis: Vec::new() }
    }

    /// At most `most` of the active vertices, evenly through the file.
    pub fn sample(&self, most: usize) -> State {
        let n = self.active.len();
        let step = n.div_ceil(most.max(1)).max(1);
        State { points: self.active.iter().step_by(step).map(|&v| self.point(v)).collect() }
    }

    /// Where a slot (base or helper) brings a point in each frame.
    pub fn carrier<'b>(&'b self, helpers: &'b [Helper], slot: u32, point: &Point) -> impl Fn(usize) -> DVec3 + 'b {
        let helper = (slot as usize).checked_sub(self.slots()).map(|h| &helpers[h]);
        let stored = match helper {
            None => point.stored,
            Some(h) => h.rest[point.group].unwrap_or(DAffine3::IDENTITY).transform_point3(point.stored),
        };
        move |frame| match helper {
            None => self.maps[frame][slot as usize].transform_point3(stored),
            Some(h) => h.moved[frame].transform_point3(stored),
        }
    }

    /// Σ w M_f over the influences of a point; `None` where it is not invertible.
    fn blend(&self, helpers: &[Helper], point: &Point, frame: usize) -> Option<DAffine3> {
        let (mut linear, mut shift, mut volume) = (DMat3::ZERO, DVec3::ZERO, 0.0);
        for i in &point.influences {
            let map = match (i.slot as usize).checked_sub(self.slots()) {
                None => self.maps[frame][i.slot as usize],
                Some(h) => helpers[h].moved[frame] * helpers[h].rest[point.group].unwrap_or(DAffine3::IDENTITY),
            };
            linear += map.matrix3 * i.weight;
            shift += map.translation * i.weight;
            volume += map.matrix3.determinant().abs() * i.weight;
        }
        let sound = linear.determinant().abs() >= LEAST_VOLUME * volume;
        sound.then_some(DAffine3 { matrix3: linear, translation: shift })
    }

    /// Where the point has to be stored so that its influences show it at rest where it was: x = (Σ w M⁰) X.
    pub fn rebound(&self, helpers: &[Helper], point: &Point) -> DVec3 {
        let blend = match self.spaces.shared[point.group] {
            Some(_) => None,
            None => self.blend(helpers, point, 0),
        };
        blend.map_or(point.stored, |b| b.inverse().transform_point3(self.rest[point.vertex]))
    }

    /// B_f = (Σ w M_f)(Σ w M_0)⁻¹ \[frame\], how a shift at rest is seen in each frame; empty where stored positions stay.
    pub fn turns(&self, helpers: &[Helper], point: &Point) -> Vec<DMat3> {
        let rest = match self.spaces.shared[point.group] {
            Some(_) => None,
            None => self.blend(helpers, point, 0).map(|b| b.matrix3.inverse()),
        };
        let Some(rest) = rest else { return Vec::new() };
        let turn = |f: usize| self.blend(helpers, point, f).map_or(DMat3::IDENTITY, |b| b.matrix3 * rest);
        (0..self.targets.len()).map(turn).collect()
    }

    /// Target less present place of a point in a frame.
    pub fn missing(&self, helpers: &[Helper], point: &Point, frame: usize) -> DVec3 {
        let place: DVec3 =
            point.influences.iter().map(|i| self.carrier(helpers, i.slot, point)(frame) * i.weight).sum();
        self.targets[frame][point.vertex] - place
    }
}

fn skinned(problem: &Problem, v: usize, f: usize) -> DVec3 {
    let x = problem.stored[v];
    problem.base[v].iter().map(|i| problem.maps[f][i.slot as usize].transform_point3(x) * i.weight).sum()
}

/// The first file vertex of every welded vertex.
fn first_of_welded(mesh: &Mesh) -> Vec<usize> {
    let mut seen = vec![false; mesh.welded_count];
    (0..mesh.positions.len()).filter(|&v| !std::mem::replace(&mut seen[mesh.welded[v] as usize], true)).collect()
}

impl State {
    /// The point of the same group that is nearest to a vertex at rest, itself if it is one of them.
    pub fn nearest(&self, problem: &Problem, vertex: usize) -> Option<&Point> {
        let group = problem.spaces.group_of[problem.base[vertex][0].slot as usize];
        let near = |p: &&Point| problem.rest[p.vertex].distance_squared(problem.rest[vertex]);
        let own = self.points.iter().filter(|p| p.group == group);
        own.min_by(|a, b| near(a).total_cmp(&near(b)).then(a.vertex.cmp(&b.vertex)))
    }

    /// How far the points are from their targets.
    pub fn error(&self, problem: &Problem, helpers: &[Helper]) -> Errors {
        let frames = problem.targets.len();
        let mut lengths: Vec<f64> = self
            .points
            .par_iter()
            .flat_map_iter(|p| (1..frames).map(move |f| problem.missing(helpers, p, f).length()))
            .collect();
        if lengths.is_empty() {
            return Errors { rms: 0.0, p99: 0.0 };
        }
        let rms = (lengths.iter().map(|l| l * l).sum::<f64>() / lengths.len() as f64).sqrt();
        let at = (0.99 * (lengths.len() - 1) as f64).round() as usize;
        Errors { rms, p99: *lengths.select_nth_unstable_by(at, f64::total_cmp).1 }
    }
}

/// Takes away the helpers that move no point.
pub fn drop_idle(problem: &Problem, state: &mut State, helpers: &mut Vec<Helper>) {
    let base = problem.slots();
    let mut busy = vec![false; helpers.len()];
    let of_helper = |i: &Influence| (i.slot as usize).checked_sub(base);
    state.points.iter().flat_map(|p| &p.influences).filter_map(of_helper).for_each(|h| busy[h] = true);
    let number: Vec<usize> = (0..busy.len()).map(|h| busy[..h].iter().filter(|b| **b).count()).collect();
    for i in state.points.iter_mut().flat_map(|p| &mut p.influences) {
        if let Some(h) = of_helper(i) {
            i.slot = (base + number[h]) as u32;
        }
    }
    let mut busy = busy.into_iter();
    helpers.retain(|_| busy.next().unwrap_or(true));
}

/// Influences sorted as everywhere: largest first, ties by slot; no more than four.
pub fn sorted(mut influences: Vec<Influence>) -> Vec<Influence> {
    influences.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.slot.cmp(&b.slot)));
    influences.truncate(INFLUENCES);
    influences
}
