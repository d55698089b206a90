//! Tets that share a modulus: groups by the joint that they are most of, and clusters of groups, coarse to fine.

use super::Tissue;
use super::normal::Normal;

/// Groups of flesh by joint: what clusters are made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Groups {
    /// The group of each skeleton joint's flesh.
    pub of_joint: Vec<u32>,
    /// The joint that gives each group its name.
    pub joints: Vec<usize>,
    /// The group above each.
    pub parents: Vec<Option<usize>>,
}

/// Groups with less than this share of the body's volume go with the one above.
const LEAST_VOLUME: f64 = 0.01;

impl Groups {
    /// At most `most` groups: every joint's flesh, the smallest merged into what is above them.
    pub fn new(tissue: &Tissue, most: usize) -> Self {
        let joints = &tissue.asset.rig.skeleton.joints;
        let mut volume = vec![0.0; joints.len()];
        for (joint, v) in main_joints(tissue).into_iter().zip(&tissue.body.volume) {
            volume[joint] += v;
        }
        let total: f64 = volume.iter().sum();
        let has = |j: usize| volume[j] > 0.0;
        let mut owner: Vec<Option<usize>> = (0..joints.len()).map(|j| Some(j).filter(|&j| has(j))).collect();
        let above = |owner: &[Option<usize>], j: usize| {
            let mut up = joints[j].parent;
            while let Some(p) = up {
                if owner[p].is_some() {
                    return owner[p];
                }
                up = joints[p].parent;
            }
            None
        };
        // A root's flesh goes with the largest group.
        loop {
            let alive: Vec<usize> = (0..joints.len()).filter(|&j| owner[j] == Some(j)).collect();
            let least = alive.iter().copied().min_by(|&a, &b| volume[a].total_cmp(&volume[b]).then(a.cmp(&b)));
            let Some(least) =
                least.filter(|&l| alive.len() > 1 && (alive.len() > most.max(1) || volume[l] < LEAST_VOLUME * total))
            else {
                break;
            };
            let others = alive.iter().copied().filter(|&j| j != least);
            let largest = others.max_by(|&a, &b| volume[a].total_cmp(&volume[b]).then(b.cmp(&a)));
            let Some(into) = above(&owner, least).filter(|&a| a != least).or(largest) else { break };
            volume[into] += std::mem::take(&mut volume[least]);
            owner.iter_mut().filter(|o| **o == Some(least)).for_each(|o| *o = Some(into));
        }
        let named: Vec<usize> = (0..joints.len()).filter(|&j| owner[j] == Some(j)).collect();
        let rank = |j: usize| named.binary_search(&j).ok();
        let group = |j: usize| owner[j].or_else(|| above(&owner, j)).and_then(rank).unwrap_or(0);
        let of_joint: Vec<u32> = (0..joints.len()).map(|j| group(j) as u32).collect();
        let up = |&j: &usize| {
            let own = of_joint[j];
            let mut up = joints[j].parent;
            while let Some(p) = up {
                if of_joint[p] != own && volume[named[of_joint[p] as usize]] > 0.0 {
                    return Some(of_joint[p] as usize);
                }
                up = joints[p].parent;
            }
            None
        };
        let parents = named.iter().map(up).collect();
        Self { of_joint, joints: named, parents }
    }

    /// The group of each tet of a body on the same skeleton.
    pub fn of_tets(&self, tissue: &Tissue) -> Vec<u32> {
        main_joints(tissue).into_iter().map(|j| self.of_joint[j]).collect()
    }

    /// Groups at or below one.
    fn below(&self, group: usize) -> Vec<bool> {
        let reaches = |mut g: usize| {
            // Parents are a forest; the count is a guard only.
            for _ in 0..=self.parents.len() {
                match self.parents[g] {
                    _ if g == group => return true,
                    Some(p) => g = p,
                    None => return false,
                }
            }
            false
        };
        (0..self.parents.len()).map(reaches).collect()
    }
}

/// The skeleton joint that most of each tet belongs to.
fn main_joints(tissue: &Tissue) -> Vec<usize> {
    let of = |tet: &[u32; 4]| {
        let weight = |c: usize| tet.iter().map(|&v| tissue.weights.rows[v as usize][c]).sum::<f64>();
        let columns = 0..tissue.weights.joints.len();
        let main = columns.max_by(|&a, &b| weight(a).total_cmp(&weight(b)).then(b.cmp(&a)));
        tissue.weights.joints[main.unwrap_or(0)]
    };
    tissue.cage.mesh.tets.iter().map(of).collect()
}

/// Cluster of each tet: the rank of the joint in `joints` (skeleton joints) that most of the tet belongs to, plus 1; 0 for the rest
/// of the body.
pub fn by_joint(tissue: &Tissue, joints: &[usize]) -> Vec<u32> {
    let rank = |joint: usize| joints.iter().position(|j| *j == joint).map_or(0, |r| r as u32 + 1);
    main_joints(tissue).into_iter().map(rank).collect()
}

/// How many clusters a division has.
pub fn count(cluster: &[u32]) -> usize {
    cluster.iter().max().map_or(0, |c| *c as usize + 1)
}

/// Splits the cluster whose parts ask for it most, if that pays: at any group, what hangs on it from the rest. `cluster` says which
/// each group is in; `system` gives the normal equations of a division into clusters, with priors. A split pays where the model's minimum falls by more than `price`.
pub(super) fn split(groups: &Groups, cluster: &mut Vec<u32>, price: f64, system: impl Fn(&[u32]) -> Normal) -> bool {
    let count = count(cluster);
    let now = system(cluster).promise();
    let mut best: Option<(f64, Vec<u32>)> = None;
    for group in 0..groups.parents.len() {
        let below = groups.below(group);
        let own = cluster[group];
        let mut parted = cluster.clone();
        let moved = |g: &usize| below[*g] && cluster[*g] == own;
        (0..parted.len()).filter(moved).for_each(|g| parted[g] = count as u32);
        if !parted.contains(&own) {
            continue;
        }
        let gain = system(&parted).promise() - now;
        if best.as_ref().is_none_or(|b| gain > b.0) {
            best = Some((gain, parted));
        }
    }
    match best.filter(|b| b.0 > price) {
        Some((_, parted)) => {
            *cluster = parted;
            true
        }
        None => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cluster_is_split_where_its_parts_pull_apart_and_not_elsewhere() {
        let groups = Groups {
            of_joint: vec![0, 1, 2, 3],
            joints: vec![0, 1, 2, 3],
            parents: vec![None, Some(0), Some(1), Some(0)],
        };
        // Groups 1 and 2 want more, 0 and 3 less.
        let mut fine = Normal::zeros(4);
        for (g, wish) in [-1.0, 1.0, 1.0, -1.0].into_iter().enumerate() {
            let mut row = [0.0; 4];
            row[g] = 1.0;
            fine.add(&row, wish, 30.0);
        }
        let system = |cluster: &[u32]| {
            let mut n = fine.merged(cluster, count(cluster));
            (0..count(cluster)).for_each(|c| n.add_prior(c, 0.0, 0.1));
            n
        };
        let mut cluster = vec![0; 4];
        assert!(split(&groups, &mut cluster, 5.0, system));
        assert_eq!(cluster, [0, 1, 1, 0]);
        assert!(!split(&groups, &mut cluster, 5.0, system), "nothing more to be had: {cluster:?}");
    }
}
