//! Which vertex buffers share a space, and where a helper's rest is in each.
//!
//! Slots that occur in one part, or in parts of one skin, have their vertices stored in one space. Where all slots of such a
//! group have the same map to the displayed rest, that map is the way from the buffer to the rest for any joint. Where they differ (the
//! displayed rest is a pose of its own) only a slot of the helper's own joint says where the helper's points are.

use animimic_scene::{Mesh, Rig};
use glam::DAffine3;

/// Maps closer than this, relative to their size, are one.
const SAME: f64 = 1e-5;

/// Groups of slots.
pub struct Spaces {
    /// Group \[slot\].
    pub group_of: Vec<usize>,
    /// The map from buffer to displayed rest that all slots of a group share, if they do \[group\].
    pub shared: Vec<Option<DAffine3>>,
    /// `displayed_from_buffer` \[slot\].
    rest: Vec<DAffine3>,
    /// Joint \[slot\].
    joints: Vec<usize>,
    /// What translations are compared with [model unit].
    size: f64,
    /// The root above each joint: joints of one skin need a common one.
    roots: Vec<usize>,
}

impl Spaces {
    /// Finds the groups.
    pub fn new(rig: &Rig, mesh: &Mesh) -> Self {
        let world = rig.skeleton.rest_world();
        let slots = &rig.skin.slots;
        let rest: Vec<DAffine3> = slots.iter().map(|s| world[s.joint] * s.inverse_bind).collect();
        let mut root: Vec<usize> = (0..slots.len()).collect();
        let mut first_of_skin: Vec<(usize, usize)> = Vec::new();
        let mut used = vec![false; slots.len()];
        for part in &mesh.parts {
            let mut first = first_of_skin.iter().find(|(s, _)| Some(*s) == part.skin).map(|p| p.1);
            let anew = first.is_none();
            for i in rig.skin.influences[part.vertices.clone()].iter().flatten() {
                used[i.slot as usize] = true;
                let to = *first.get_or_insert(i.slot as usize);
                let (a, b) = (find(&root, to), find(&root, i.slot as usize));
                root[a.max(b)] = a.min(b);
            }
            if let (true, Some(skin), Some(first)) = (anew, part.skin, first) {
                first_of_skin.push((skin, first));
            }
        }
        let mut group_of = vec![usize::MAX; slots.len()];
        let mut shared: Vec<Option<DAffine3>> = Vec::new();
        let size = 1.0 + mesh.diagonal();
        for s in 0..slots.len() {
            let r = find(&root, s);
            if r == s {
                group_of[s] = shared.len();
                shared.push(Some(rest[s]));
                continue;
            }
            group_of[s] = group_of[r];
            let group = &mut shared[group_of[r]];
            if used[s] && group.is_some_and(|g| !same(&g, &rest[s], size)) {
                *group = None;
            }
        }
        let mut roots: Vec<usize> = Vec::new();
        for (j, joint) in rig.skeleton.joints.iter().enumerate() {
            roots.push(joint.parent.map_or(j, |p| roots[p]));
        }
        Self { group_of, shared, rest, joints: slots.iter().map(|s| s.joint).collect(), size, roots }
    }

    /// Where the points of a helper are at rest that is born on `joint` in the group `home`: the map from a group's buffers to the displayed
    /// rest \[group\]. `None` where it would be another than at home: a joint with two inverse binds has no bind pose that importers agree on.
    pub fn maps(&self, joint: usize, home: usize) -> Vec<Option<DAffine3>> {
        let own = self.map(joint, home);
        let fits = |m: &DAffine3| own.is_some_and(|o| same(&o, m, self.size));
        (0..self.shared.len()).map(|g| self.map(joint, g).filter(fits)).collect()
    }

    fn map(&self, joint: usize, group: usize) -> Option<DAffine3> {
        let mut slots = (0..self.joints.len()).filter(|&s| self.group_of[s] == group);
        let own = slots.clone().find(|&s| self.joints[s] == joint);
        let one_tree = slots.any(|s| self.roots[self.joints[s]] == self.roots[joint]);
        self.shared[group].filter(|_| one_tree).or_else(|| own.map(|s| self.rest[s]))
    }

    /// Whether the displayed rest is the bind pose everywhere.
    pub fn rest_is_bind(&self) -> bool {
        self.shared.iter().all(Option::is_some)
    }
}

fn find(root: &[usize], mut s: usize) -> usize {
    while root[s] != s {
        s = root[s];
    }
    s
}

fn same(a: &DAffine3, b: &DAffine3, size: f64) -> bool {
    let scale = a.matrix3.to_cols_array().iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let linear = (a.matrix3 - b.matrix3).to_cols_array().iter().fold(0.0f64, |m, x| m.max(x.abs()));
    linear <= SAME * scale && (a.translation - b.translation).length() <= SAME * size
}
