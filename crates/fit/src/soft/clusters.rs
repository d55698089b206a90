//! Clusters of tets that share a modulus: by the joint that they are most of, coarse to fine.

use super::Tissue;

/// Cluster of each tet: the rank of the joint in `joints` (skeleton joints) that most of the tet belongs to, plus 1; 0 for the rest
/// of the body.
pub fn by_joint(tissue: &Tissue, joints: &[usize]) -> Vec<u32> {
    let of = |tet: &[u32; 4]| {
        let weight = |c: usize| tet.iter().map(|&v| tissue.weights.rows[v as usize][c]).sum::<f64>();
        let columns = 0..tissue.weights.joints.len();
        let main = columns.max_by(|&a, &b| weight(a).total_cmp(&weight(b)).then(b.cmp(&a)));
        let rank = main.and_then(|c| joints.iter().position(|j| *j == tissue.weights.joints[c]));
        rank.map_or(0, |r| r as u32 + 1)
    };
    tissue.cage.mesh.tets.iter().map(of).collect()
}
