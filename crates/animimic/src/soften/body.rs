//! A clip with soft tissue: simulated, blended with skinning where asked for, and uncrossed.

use super::yielding::{Yielded, give_way};
use crate::Error;
use animimic_fit::soft::learn::skinned;
use animimic_fit::soft::{Report as Simulation, Stepping, Tissue};
use animimic_scene::{Motion, Refined, Trajectory};
use animimic_sim::Elasticity;
use glam::DVec3;
use serde_json::{Value, json};
use std::time::Instant;

/// A clip with soft tissue.
pub(crate) struct Softened {
    pub motion: Motion,
    /// Surfaces \[frame\]\[vertex\].
    pub skinned: Vec<Vec<DVec3>>,
    pub soft: Vec<Vec<DVec3>>,
    pub simulation: Simulation,
    /// Young's modulus of the flesh at the surface [Pa], per vertex.
    pub youngs: Vec<f32>,
    /// `None` before crossings were looked for.
    pub yielded: Option<Yielded>,
    pub tets: usize,
    /// Wall time of the forward simulation [s].
    pub simulated_s: f64,
}

/// Simulates a motion.
pub(crate) fn soften(
    tissue: &Tissue,
    elasticity: &Elasticity,
    stepping: &Stepping,
    motion: &Motion,
) -> Result<Softened, Error> {
    let clock = Instant::now();
    let simulated = tissue.simulate(elasticity, stepping, &motion.poses, motion.fps)?;
    let simulated_s = clock.elapsed().as_secs_f64();
    let (skinned, soft) = (skinned(tissue.asset, &motion.poses), simulated.surfaces(tissue, &motion.poses));
    let (simulation, tets) = (simulated.report, tissue.body.tets.len());
    // That of the tet that carries the vertex.
    let young = |tet: &u32| elasticity.ln_youngs[elasticity.cluster[*tet as usize] as usize].exp() as f32;
    let youngs = tissue.cage.embedding.tet.iter().map(young).collect();
    Ok(Softened { motion: motion.clone(), skinned, soft, simulation, youngs, yielded: None, tets, simulated_s })
}

impl Softened {
    /// Gives way to skinning where the surface cuts itself more than that.
    pub fn uncross(&mut self, tissue: &Tissue) {
        self.yielded = Some(give_way(&tissue.asset.mesh, &self.skinned, &mut self.soft));
    }

    /// The clip with its surface.
    pub fn refined(&self) -> Refined {
        let trajectory = Trajectory { fps: self.motion.fps, frames: self.soft.clone() };
        Refined { motion: self.motion.clone(), trajectory: Some(trajectory) }
    }

    /// What happened, for reports; distances in % of `diagonal`.
    pub fn to_json(&self, diagonal: f64) -> Value {
        let r = &self.simulation;
        let pairs = self.skinned.iter().flatten().zip(self.soft.iter().flatten());
        let (sum, count) = pairs.fold((0.0, 0usize), |(s, n), (a, b)| (s + a.distance_squared(*b), n + 1));
        let missed = r.unconverged.iter().map(|(frame, speed)| json!({"frame": frame, "speed_m_per_s": speed}));
        let mut out = json!({
            "tets": self.tets, "steps_per_frame": r.substeps, "newton_iterations": r.newton,
            "inverted_tets": r.inverted, "volume_change": r.volume_change, "missed_steps": missed.collect::<Vec<_>>(),
            "from_skinning_rms_percent": 100.0 * (sum / count.max(1) as f64).sqrt() / diagonal,
        });
        if let Some(y) = &self.yielded {
            out["self_intersections_skinned"] = y.skinned_pairs.into();
            out["self_intersections_before"] = y.soft_pairs.into();
            out["self_intersections"] = y.pairs.into();
            out["yielded_share"] = y.share.into();
        }
        out
    }
}
