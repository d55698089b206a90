//! The recorded gradient test of the rivals. Skips where the recordings are absent.

#[path = "../examples/rivals/maskgrad.rs"]
mod maskgrad;
#[path = "../examples/rivals/refine.rs"]
mod refine;
#[path = "../benches/support/mod.rs"]
mod support;

use std::path::Path;

fn data() -> Option<&'static Path> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/bench/diffrender/data"));
    if !path.exists() {
        println!("skipped: {} is not there", path.display());
        return None;
    }
    Some(path)
}

#[test]
fn the_mask_gradient_to_93_pose_parameters_is_at_least_as_good_as_edgegrads() {
    let Some(data) = data() else { return };
    let q = maskgrad::quality(data);
    println!("cosine {:.5}, norm ratio {:.4}, relative error {:.4}", q.cosine, q.norm_ratio, q.relative_error);
    assert!(q.cosine >= 0.9996 && (q.norm_ratio - 1.0).abs() <= 0.02 && q.relative_error <= 0.03);
}

#[test]
fn poses_are_refined_by_colour_and_mask_from_68_mm_to_about_a_centimetre_from_any_start() {
    let Some(data) = data() else { return };
    let r = refine::refinement(data);
    println!("{:.0} mm → {:.1?}, median {:.1} mm", r.start_mm, r.end_mm, r.median_mm());
    assert!(r.end_mm.len() >= 10 && r.median_mm() <= 10.0 && r.end_mm.iter().all(|&e| e <= 15.0));
}
