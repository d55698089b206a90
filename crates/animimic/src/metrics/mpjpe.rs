//! MPJPE: mean joint position error over the joints that move something.

use super::{Evidence, Metric, Missing, Reading, mean};

pub struct Mpjpe;

impl Metric for Mpjpe {
    fn name(&self) -> &'static str {
        "mpjpe"
    }

    fn definition(&self) -> &'static str {
        "mean over frames and over joints carrying weight (themselves or through a descendant) of |Ĵ − J| in % of the rest diagonal; image-plane and depth parts"
    }

    fn measure(&self, e: &Evidence) -> Result<Vec<Reading>, Missing> {
        let truth = e.need_truth()?;
        if truth.joint_names.is_empty() {
            return Err(Missing("the truth has no joints"));
        }
        if truth.soft {
            return Err(Missing("the truth moves beyond its skeleton"));
        }
        let wanted = truth.joints_that_move_something();
        let pairs: Vec<(usize, usize)> =
            wanted.iter().filter_map(|&k| truth.joint_in(k, e.asset).map(|j| (k, j))).collect();
        if pairs.is_empty() {
            return Err(Missing("no joint of the truth is in the result"));
        }
        let mut out = vec![
            ("joints_compared".into(), pairs.len() as f64),
            ("joints_missing".into(), (wanted.len() - pairs.len()) as f64),
        ];
        if pairs.len() < wanted.len() {
            return Ok(out);
        }
        let percent = 100.0 / e.diagonal();
        let errors: Vec<_> = e
            .joints
            .iter()
            .zip(&truth.joints)
            .flat_map(|(own, real)| pairs.iter().map(|&(k, j)| own[j] - real[k]))
            .collect();
        out.push(("mpjpe_pct".into(), mean(errors.iter().map(|d| d.length())) * percent));
        if let Some(camera) = e.camera {
            let view: Vec<_> = errors.iter().map(|d| camera.view_from_world.transform_vector3(*d)).collect();
            out.push(("mpjpe_plane_pct".into(), mean(view.iter().map(|v| v.truncate().length())) * percent));
            out.push(("mpjpe_depth_pct".into(), mean(view.iter().map(|v| v.z.abs())) * percent));
        }
        Ok(out)
    }
}
