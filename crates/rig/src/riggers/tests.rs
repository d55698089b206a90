//! What holds for every rigger and every surface.

use super::fixtures::{quadruped, soup, triangle, trousers, walking};
use super::*;

fn check(name: &str, asset: &Asset, rig: &Rig) {
    let joints = &rig.skeleton.joints;
    println!("{name}: {} joints", joints.len());
    assert!((1..=80).contains(&joints.len()), "{name}: {} joints", joints.len());
    assert_eq!(joints.iter().filter(|j| j.parent.is_none()).count(), 1, "{name}: one root");
    assert!(joints.iter().enumerate().all(|(k, j)| j.parent.is_none_or(|p| p < k)), "{name}: parents first");
    let mut names: Vec<&str> = joints.iter().map(|j| j.name.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), joints.len(), "{name}: names are unique");
    assert_eq!(rig.skin.influences.len(), asset.mesh.positions.len());
    for list in &rig.skin.influences {
        assert!((1..=4).contains(&list.len()) && list.iter().all(|i| i.weight >= 0.0), "{name}: {list:?}");
        assert_eq!(list.iter().map(|i| i.weight).sum::<f64>(), 1.0, "{name}: {list:?}");
    }
    let rest = rig.at_rest();
    let off = rest.iter().zip(&asset.mesh.positions).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    assert!(off < 1e-12 * (1.0 + asset.mesh.diagonal()), "{name}: rest is off by {off:e}");
}

#[test]
fn every_rigger_gives_a_sound_rig_to_every_surface_or_says_what_it_lacks() {
    for rigger in RIGGERS {
        assert!(rigger.summary().len() > 20 && super::rigger(rigger.name()).is_some());
        for (name, asset) in
            [("quadruped", quadruped()), ("trousers", trousers()), ("soup", soup()), ("triangle", triangle())]
        {
            match rigger.rig(&asset, &RigOptions::default()) {
                Ok(rig) => check(&format!("{} {name}", rigger.name()), &asset, &rig),
                Err(e) => assert!(matches!(e, RigError::FileMissing), "{e}"),
            }
        }
    }
}

#[test]
fn a_symmetric_quadruped_gets_mirrored_legs_a_head_and_a_tail() {
    let rig = RIGGERS[0].rig(&quadruped(), &RigOptions::default()).expect("a sound surface");
    let world = rig.skeleton.rest_world();
    let at = |name: &str| {
        let j = rig.skeleton.joints.iter().position(|j| j.name == name);
        world[j.unwrap_or_else(|| panic!("{name} is missing"))].translation
    };
    let names: Vec<&str> = rig.skeleton.joints.iter().map(|j| j.name.as_str()).collect();
    println!("{names:?}");
    assert!(at("head").z > 0.5 && at("tail_01").z < -0.4, "{:?} {:?}", at("head"), at("tail_01"));
    for name in names.iter().filter(|n| n.contains("_L_")) {
        let (left, right) = (at(name), at(&name.replace("_L_", "_R_")));
        // Facing +z with +y up, left is +x.
        assert!(left.x > 0.0 && (left * DVec3::new(-1.0, 1.0, 1.0)).distance(right) < 0.01, "{name}: {left} {right}");
    }
    for leg in ["leg_front_L_02", "leg_back_R_02"] {
        assert!(at(leg).y < 0.8 && (at(leg).z.abs() - 0.5).abs() < 0.15, "{leg} {:?}", at(leg));
    }
}

#[test]
fn legs_in_mid_stride_are_paired_hang_beside_each_other_and_have_equal_bones() {
    let rig = RIGGERS[0].rig(&walking(), &RigOptions::default()).expect("a sound surface");
    let joints = &rig.skeleton.joints;
    let world = rig.skeleton.rest_world();
    let find = |name: &str| joints.iter().position(|j| j.name == name).unwrap_or_else(|| panic!("{name} is missing"));
    println!("{:?}", joints.iter().map(|j| j.name.as_str()).collect::<Vec<_>>());
    for row in ["front", "back"] {
        let [left, right] = ["L", "R"].map(|side| find(&format!("leg_{row}_{side}_01")));
        let (a, b) = (world[left].translation, world[right].translation);
        println!("{row}: hips at {a} and {b}");
        assert_eq!(joints[left].parent, joints[right].parent, "{row} hips hang on one joint");
        assert!(a.x > 0.05 && (a * DVec3::new(-1.0, 1.0, 1.0)).distance(b) < 1e-6, "{row} hips mirror each other");
        assert!(a.y > 0.85 && (a.z.abs() - 0.5).abs() < 0.12, "{row} hip {a} is beside the trunk's axis");
        let bone = |side: &str| {
            let ends = [1, 2].map(|k| world[find(&format!("leg_{row}_{side}_0{k}"))].translation);
            ends[0].distance(ends[1])
        };
        println!("first bones {} and {}", bone("L"), bone("R"));
        assert!((bone("L") - bone("R")).abs() < 0.1 * bone("L"));
    }
}

#[test]
fn no_leg_moves_another_one_across_a_gap_narrower_than_a_voxel() {
    for asset in [trousers(), quadruped()] {
        let rig = RIGGERS[0].rig(&asset, &RigOptions::default()).expect("a sound surface");
        let name = |slot: u32| rig.skeleton.joints[slot as usize].name.as_str();
        let mut worst = 0.0f64;
        for (p, list) in asset.mesh.positions.iter().zip(&rig.skin.influences).filter(|v| v.0.y < 0.55) {
            let other = if p.x > 0.0 { "_R_" } else { "_L_" };
            worst = worst.max(list.iter().filter(|i| name(i.slot).contains(other)).map(|i| i.weight).sum());
        }
        println!("largest weight of the other leg: {worst}");
        assert_eq!(worst, 0.0);
    }
}

#[test]
fn more_detail_gives_more_bones() {
    let count = |detail| {
        let options = RigOptions { detail, ..RigOptions::default() };
        RIGGERS[0].rig(&quadruped(), &options).expect("a sound surface").skeleton.joints.len()
    };
    let counts = [1, 3, 5].map(count);
    println!("{counts:?}");
    assert!(counts[0] >= 8 && counts[0] < counts[1] && counts[1] < counts[2] && counts[2] <= 80);
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let rig = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| RIGGERS[0].rig(&quadruped(), &RigOptions::default()).expect("a sound surface"))
    };
    let (a, b) = (rig(1), rig(3));
    assert_eq!(a.skin.influences, b.skin.influences);
    assert!(a.skeleton.joints.iter().zip(&b.skeleton.joints).all(|(p, q)| p.rest == q.rest && p.name == q.name));
}
