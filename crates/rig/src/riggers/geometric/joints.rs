//! Joints on chains: where limbs bend, else where bodies usually do.

use super::anatomy::{Anatomy, Role, arc, nearest};
use super::bends::{bends, proportions, ways};
use super::chains::Graph;
use super::symmetry::Mirror;
use glam::DVec3;

/// Lengths of bones [longest side] at the middle level of detail.
const SPINE_BONE: f64 = 0.11;
const NECK_BONE: f64 = 0.10;
const TAIL_BONE: f64 = 0.085;
const LIMB_BONE: f64 = 0.08;
const TWIG_BONE: f64 = 0.08;

/// From this fineness on limbs may have more bones than bodies have joints.
const FINE: f64 = 1.2;

/// A limb begins where its balls grow beyond this many times its usual radius, at most this share of it from the trunk.
const FLARE: f64 = 1.45;
const ROOT_SHARE: f64 = 0.4;

/// A limb's first joint lies above where it comes out, straight on, this share of the way to the trunk's axis.
const SOCKET: f64 = 0.55;
/// A leg under a lying trunk begins this share of the way up to the height of its axis, and leans on the way by this share of the whole
/// leg's lean: a thigh leans forward above a hock that leans back.
const BESIDE_AXIS: f64 = 0.85;
const LEAN: f64 = 0.5;

/// Medial balls of a limb count up to this many times its usual radius.
const CARRIED: f64 = 1.3;

/// A head is what lies beyond a neck narrower than the head by this factor.
const NECK: f64 = 1.12;
/// Without a neck the head is this share of what lies before the chest.
const HEADLESS: f64 = 0.5;

/// A joint to be.
#[derive(Clone, Debug)]
pub(crate) struct Draft {
    /// What it belongs to, and its number there; the head has none.
    pub stem: String,
    pub number: Option<usize>,
    pub position: DVec3,
    pub parent: Option<usize>,
    /// Medial balls that it carries: centre, radius.
    pub seeds: Vec<(DVec3, f64)>,
    /// Lies beside the plane of an exactly symmetric body: to be mirrored.
    pub lateral: bool,
    /// Chain that it lies on.
    pub chain: usize,
}

/// All joints, parents first. Of exactly symmetric bodies the half that is there.
pub(crate) fn joints(graph: &Graph, anatomy: &Anatomy, mirror: Option<&Mirror>, fineness: f64) -> Vec<Draft> {
    let mut builder = Builder { graph, anatomy, mirror, fineness, drafts: Vec::new(), owner: Vec::new() };
    builder.trunk();
    for c in 1..anatomy.chains.len() {
        builder.limb(c);
    }
    builder.drafts
}

/// A limb from where it turns in the trunk to its tip.
struct Curve {
    points: Vec<DVec3>,
    /// The first points, which lie within the trunk.
    inner: usize,
    /// Place in the chain of the first point after those.
    hip: usize,
}

impl Curve {
    /// Place in the chain of a point, the hip for those within the trunk.
    fn node(&self, point: usize) -> usize {
        self.hip + point.saturating_sub(self.inner)
    }
}

struct Builder<'a> {
    graph: &'a Graph<'a>,
    anatomy: &'a Anatomy,
    mirror: Option<&'a Mirror>,
    fineness: f64,
    drafts: Vec<Draft>,
    /// Joint that carries each place \[chain\]\[place\].
    owner: Vec<Vec<usize>>,
}

impl Builder<'_> {
    fn trunk(&mut self) {
        let nodes = &self.anatomy.chains[0].nodes;
        let along = arc(self.graph, nodes);
        let pelvis = self.anatomy.pelvis;
        self.owner.push(vec![0; nodes.len()]);
        self.push("pelvis".into(), None, (0, pelvis), None);
        let end = nodes.len() - 1;
        let chest = self.anatomy.chest.unwrap_or(pelvis);
        let head = self.head(&along, chest.max(pelvis));
        // Forward: spine to the chest, neck to the head, head.
        let mut places = Vec::new();
        let stops = match self.anatomy.chest {
            Some(c) => [(c, "spine", SPINE_BONE), (head.unwrap_or(end), "neck", NECK_BONE)],
            None => [(head.unwrap_or(end), "spine", SPINE_BONE), (head.unwrap_or(end), "neck", NECK_BONE)],
        };
        let mut from = pelvis;
        for (to, name, bone) in stops {
            let length = (along[to] - along[from]).max(0.0);
            let count = (length / (bone * self.graph.longest / self.fineness)).round() as usize;
            let count = if name == "spine" && length > 0.06 * self.graph.longest { count.max(2) } else { count };
            let closing = usize::from(to == end && head.is_none());
            for k in 1..=count.saturating_sub(closing) {
                let s = along[from] + length * k as f64 / count as f64;
                places.push((nearest(&along, s), name));
            }
            from = to;
        }
        if let Some(h) = head {
            places.retain(|p| p.0 != h);
            places.push((h, "head"));
        }
        let forward: Vec<(usize, &str)> = places.into_iter().filter(|p| p.0 > pelvis).collect();
        self.row(&forward, &along, 1);
        let backward: Vec<(usize, &str)> =
            self.tail(&along).into_iter().filter(|&p| p < pelvis).map(|p| (p, "tail")).collect();
        self.row(&backward, &along, -1);
        self.carry(0, 0);
    }

    /// Joints one after the other along the trunk, from the pelvis outwards.
    fn row(&mut self, places: &[(usize, &str)], along: &[f64], direction: isize) {
        let (mut parent, mut last) = (0, self.anatomy.pelvis);
        let mut number = (String::new(), 0);
        for &(place, name) in places {
            if place == last || (along[place] - along[last]).abs() < 0.02 * self.graph.longest / self.fineness {
                continue;
            }
            number = if number.0 == name { (number.0, number.1 + 1) } else { (name.to_owned(), 1) };
            let count = (name != "head").then_some(number.1);
            parent = self.push(name.into(), count, (0, place), Some(parent));
            let own = &mut self.owner[0];
            if direction > 0 {
                own[place..].fill(parent)
            } else {
                own[..=place].fill(parent)
            }
            last = place;
        }
    }

    /// Where the head begins: behind the narrowest place before it.
    fn head(&self, along: &[f64], from: usize) -> Option<usize> {
        let nodes = &self.anatomy.chains[0].nodes;
        let end = nodes.len() - 1;
        let whole = along[end] - along[from];
        if whole < 0.05 * self.graph.longest || end - from < 4 {
            return None;
        }
        let radius = |i: usize| self.graph.radius(nodes[i]);
        let share = |i: usize| (along[i] - along[from]) / whole;
        let waist = (from..=end)
            .filter(|&i| share(i) < 0.8)
            .filter(|&i| (i..=end).map(radius).fold(0.0, f64::max) > NECK * radius(i))
            .min_by(|&a, &b| radius(a).total_cmp(&radius(b)));
        // A trunk that ends within its thickest ball: the head begins where that does.
        let last = nodes[end];
        let ball = (self.graph.tree.nodes[last].parent.is_none()).then(|| {
            (from..=end).find(|&i| self.graph.at(nodes[i]).distance(self.graph.at(last)) < self.graph.radius(last))
        });
        waist.or(ball.flatten()).or_else(|| Some(nearest(along, along[from] + (1.0 - HEADLESS) * whole)))
    }

    /// Places of the tail's joints, from the pelvis outwards.
    fn tail(&self, along: &[f64]) -> Vec<usize> {
        let nodes = &self.anatomy.chains[0].nodes;
        let pelvis = self.anatomy.pelvis;
        let ball = self.graph.radius(nodes[pelvis]);
        let Some(base) = (0..pelvis)
            .rev()
            .find(|&i| self.graph.radius(nodes[i]) < 0.6 * ball || along[pelvis] - along[i] > 1.2 * ball)
        else {
            return Vec::new();
        };
        let bone = TAIL_BONE * self.graph.longest / self.fineness;
        if along[base] < 0.4 * bone {
            return Vec::new();
        }
        let count = (along[base] / bone).round().max(1.0) as usize;
        (0..count).map(|k| nearest(along, along[base] * (1.0 - k as f64 / count as f64))).collect()
    }

    fn limb(&mut self, c: usize) {
        let chain = &self.anatomy.chains[c];
        let Some((on, at)) = chain.parent else { return };
        let role = self.anatomy.roles[c];
        let parent = self.owner[on][if on == 0 { self.anatomy.place[c] } else { at }];
        let curve = self.curve(c);
        let mut partners = vec![curve.points.clone()];
        partners.extend(self.anatomy.partner[c].map(|p| self.curve(p).points));
        let count = self.bones(role).min(curve.points.len() / 2).max(1);
        let along = ways(&curve.points);
        let whole = along[along.len() - 1];
        let mut owner = vec![parent; chain.nodes.len()];
        let first = self.drafts.len();
        let mut last = parent;
        for (k, share) in bends(&partners, count, proportions(role, count)).into_iter().enumerate() {
            let name = stem(role, &self.drafts[parent].stem);
            let begin = nearest(&along, share * whole);
            last = self.push(name, Some(k + 1), (c, curve.node(begin)), Some(last));
            self.drafts[last].position = curve.points[begin];
            if k == 0 && on == 0 && self.least_bones(role) > 1 {
                self.drafts[last].position = self.shared_socket(c);
            }
            owner[curve.node(begin)..].fill(last);
        }
        self.owner.push(owner);
        // Shoulder blades and thighs lie on the flanks of a lying trunk and move with their legs; an upright trunk holds its own.
        if self.reaches_beside(c) {
            let radius = self.graph.radius(chain.nodes[curve.hip]).min(CARRIED * self.usual_radius(c));
            self.drafts[first].seeds.extend(curve.points[..curve.inner].iter().map(|&p| (p, radius)));
        }
        self.carry(c, first);
    }

    /// The line along which a limb's joints lie.
    fn curve(&self, c: usize) -> Curve {
        let chain = &self.anatomy.chains[c];
        let along = arc(self.graph, &chain.nodes);
        let hip = self.hip(c, &along);
        let own: Vec<DVec3> = chain.nodes[hip..].iter().map(|&k| self.graph.at(k)).collect();
        if !self.reaches_beside(c) {
            return Curve { points: own, inner: 0, hip };
        }
        let socket = self.shared_socket(c);
        let step = (along[along.len() - 1] - along[hip]) / (own.len() - 1).max(1) as f64;
        let inner = (socket.distance(own[0]) / step.max(1e-9 * self.graph.longest)).ceil() as usize;
        let hip_at = own[0];
        let points = (0..inner).map(|k| socket.lerp(hip_at, k as f64 / inner as f64)).chain(own).collect();
        Curve { points, inner, hip }
    }

    /// Bones of a limb at least: legs and arms have three, unless few are wanted.
    fn least_bones(&self, role: Role) -> usize {
        match role {
            Role::Leg(..) | Role::Arm | Role::Wing if self.fineness >= 1.0 => 3,
            Role::Leg(..) | Role::Arm | Role::Wing => 2,
            Role::Trunk | Role::Ear | Role::TailFin | Role::Fin | Role::Twig => 1,
        }
    }

    /// Bones of a limb: as many as fit its length, the same for all limbs of a kind, because partners bend alike.
    fn bones(&self, role: Role) -> usize {
        let bone = if self.least_bones(role) > 1 { LIMB_BONE } else { TWIG_BONE };
        let mut wanted: Vec<usize> = (1..self.anatomy.chains.len())
            .filter(|&c| self.anatomy.roles[c] == role)
            .map(|c| {
                let points = self.curve(c).points;
                let length = ways(&points)[points.len() - 1];
                (length / (bone * self.graph.longest / self.fineness)).round() as usize
            })
            .collect();
        wanted.sort_unstable();
        let usual = wanted.get(wanted.len() / 2).copied().unwrap_or(1);
        let most = match role {
            // Of those who walk upright, the limbs bend at elbow and wrist, knee and ankle.
            Role::Leg(..) | Role::Arm if self.anatomy.upright && self.fineness < FINE => 3,
            _ if self.fineness < FINE => 4,
            _ => 6,
        };
        usual.clamp(self.least_bones(role), most)
    }

    /// Place where a limb comes out of what it grows on.
    fn hip(&self, c: usize, along: &[f64]) -> usize {
        let chain = &self.anatomy.chains[c];
        let nodes = &chain.nodes;
        let whole = along[along.len() - 1];
        let usual = self.usual_radius(c);
        let flare = (0..nodes.len())
            .rev()
            .find(|&i| along[i] < 0.6 * whole && self.graph.radius(nodes[i]) > FLARE * usual)
            .unwrap_or(0);
        let furthest = nearest(along, along[chain.exit] + ROOT_SHARE * (whole - along[chain.exit]));
        chain.exit.max(flare.min(furthest)).min(nodes.len() - 1)
    }

    /// Where a limb turns in the trunk: straight on from its upper part. Legs under a lying trunk reach up beside its axis, as shoulder
    /// blades and thighs do.
    fn socket(&self, c: usize) -> DVec3 {
        let chain = &self.anatomy.chains[c];
        let nodes = &chain.nodes;
        let along = arc(self.graph, nodes);
        let hip = self.hip(c, &along);
        let axis = self.graph.at(self.anatomy.chains[0].nodes[self.anatomy.place[c]]);
        let from = self.graph.at(nodes[hip]);
        if self.reaches_beside(c) {
            let rise = BESIDE_AXIS * (axis.y - from.y).max(0.0);
            let leg = (from - self.graph.at(nodes[nodes.len() - 1])).reject_from_normalized(self.anatomy.left);
            let lean = (LEAN / leg.y.abs().max(1e-9 * self.graph.longest) * leg).with_y(0.0).clamp_length_max(LEAN);
            return from + rise * (DVec3::Y + lean);
        }
        let below = nearest(&along, along[hip] + 0.3 * (along[along.len() - 1] - along[hip]));
        let up = (from - self.graph.at(nodes[below])).normalize_or_zero();
        let reach = (axis - from).dot(up).max(0.0);
        let inwards = from + 0.5 * SOCKET * (axis - from);
        0.5 * (from + SOCKET * reach * up) + 0.5 * inwards
    }

    /// The same for both partners, mirrored.
    fn shared_socket(&self, c: usize) -> DVec3 {
        match (self.anatomy.partner[c], self.mirror) {
            (Some(partner), Some(mirror)) => 0.5 * (self.socket(c) + mirror.image(self.socket(partner))),
            _ => self.socket(c),
        }
    }

    /// Whether a limb begins beside the trunk's axis: a leg under a lying trunk.
    fn reaches_beside(&self, c: usize) -> bool {
        matches!(self.anatomy.roles[c], Role::Leg(..)) && !self.anatomy.upright
    }

    /// Median radius of a limb's outer two thirds.
    fn usual_radius(&self, c: usize) -> f64 {
        let nodes = &self.anatomy.chains[c].nodes;
        let mut radii: Vec<f64> = nodes[nodes.len() / 3..].iter().map(|&k| self.graph.radius(k)).collect();
        radii.sort_by(f64::total_cmp);
        radii[radii.len() / 2]
    }

    fn push(
        &mut self,
        stem: String,
        number: Option<usize>,
        (chain, place): (usize, usize),
        parent: Option<usize>,
    ) -> usize {
        let node = self.anatomy.chains[chain].nodes[place];
        let lateral = !self.graph.tree.nodes[node].central || parent.is_some_and(|p| self.drafts[p].lateral);
        let position = self.graph.at(node);
        self.drafts.push(Draft { stem, number, position, parent, seeds: Vec::new(), lateral, chain });
        self.drafts.len() - 1
    }

    /// Gives the joints their medial balls; those of a limb are no larger than the limb.
    fn carry(&mut self, c: usize, first: usize) {
        let most = if c == 0 { f64::INFINITY } else { CARRIED * self.usual_radius(c) };
        for (i, &k) in self.anatomy.chains[c].nodes.iter().enumerate() {
            let joint = self.owner[c][i];
            if joint >= first {
                self.drafts[joint].seeds.push((self.graph.at(k), self.graph.radius(k).min(most)));
            }
        }
    }
}

/// First word of a limb's joints.
fn stem(role: Role, parent: &str) -> String {
    match role {
        Role::Trunk => "spine".into(),
        Role::Leg(_, 1) => "leg".into(),
        Role::Leg(0, _) => "leg_back".into(),
        Role::Leg(row, count) if row + 1 == count => "leg_front".into(),
        Role::Leg(row, _) => format!("leg_mid{row}"),
        Role::Arm => "arm".into(),
        Role::Wing => "wing".into(),
        Role::Ear => "ear".into(),
        Role::TailFin => "tail_fin".into(),
        Role::Fin => "fin".into(),
        Role::Twig => format!("{}_branch", parent.trim_end_matches("_branch")),
    }
}
