//! Every bad input is refused by a typed error that names the culprit.

use animimic_scene::TetMesh;
use animimic_sim::fixtures::beam;
use animimic_sim::{Body, Elasticity, Model, Settings, SimError, State, Stepper, simulate, simulate_vjp};
use glam::DVec3;

fn good() -> TetMesh {
    beam([2, 1, 1], [1.0, 0.5, 0.5])
}

#[test]
fn bad_meshes_are_refused_by_element() {
    let mut mesh = good();
    mesh.positions[5].y = f64::NAN;
    assert!(matches!(Body::new(&mesh, &[]), Err(SimError::NotFinite { index: 5, .. })));
    let mut mesh = good();
    mesh.tets[7].swap(0, 1);
    assert!(matches!(Body::new(&mesh, &[]), Err(SimError::InvertedTet { tet: 7, .. })));
    let mut mesh = good();
    mesh.tets[3][1] = mesh.tets[3][0];
    assert!(matches!(Body::new(&mesh, &[]), Err(SimError::FlatTet { tet: 3, .. })));
    let mut mesh = good();
    mesh.positions.push(DVec3::ONE);
    assert_eq!(Body::new(&mesh, &[]).err(), Some(SimError::LooseVertex { vertex: 12 }));
    let mut mesh = good();
    mesh.tets[2][3] = 99;
    assert!(matches!(Body::new(&mesh, &[]), Err(SimError::VertexOutOfRange { tet: 2, vertex: 99, .. })));
    assert_eq!(Body::new(&TetMesh::default(), &[]).err(), Some(SimError::Empty));
    assert!(matches!(Body::new(&good(), &[3, 400]), Err(SimError::DrivenVertex { vertex: 400, .. })));
    assert!(matches!(Body::new(&good(), &[3, 1, 3]), Err(SimError::DrivenVertex { vertex: 3, .. })));
}

#[test]
fn bad_materials_are_refused_by_cluster_or_name() {
    let tets = good().tets.len();
    let check = |change: &dyn Fn(&mut Elasticity)| {
        let mut e = Elasticity::uniform(Model::FixedCorotated, tets, 1e5, 0.4, 1000.0);
        change(&mut e);
        e.validate(tets)
    };
    assert_eq!(check(&|_| ()), Ok(()));
    assert!(matches!(check(&|e| e.ln_youngs = vec![1.0, (-5.0f64).ln()]), Err(SimError::Modulus { cluster: 1, .. })));
    assert!(matches!(check(&|e| e.ln_youngs[0] = f64::INFINITY), Err(SimError::Modulus { cluster: 0, .. })));
    assert!(matches!(check(&|e| e.ln_youngs[0] = 0f64.ln()), Err(SimError::Modulus { cluster: 0, .. })));
    for poisson in [0.5, 0.7, -1.0, f64::NAN] {
        assert!(matches!(check(&|e| e.poisson = poisson), Err(SimError::OutOfRange { name: "Poisson's ratio", .. })));
    }
    assert!(matches!(check(&|e| e.density = 0.0), Err(SimError::OutOfRange { name: "density", .. })));
    assert!(matches!(check(&|e| e.cluster[4] = 9), Err(SimError::ClusterOutOfRange { tet: 4, cluster: 9, .. })));
    assert!(matches!(check(&|e| e.cluster.truncate(3)), Err(SimError::Length { got: 3, .. })));
    let negative = Elasticity::per_tet(Model::FixedCorotated, &[1.0, -2.0], 0.3, 1.0).validate(2);
    println!("{}", negative.clone().expect_err("negative modulus"));
    assert!(matches!(negative, Err(SimError::Modulus { cluster: 1, .. })));
}

#[test]
fn bad_settings_states_and_losses_are_refused() {
    let mesh = good();
    let body = Body::new(&mesh, &[0]).expect("a good mesh");
    let elasticity = Elasticity::uniform(Model::FixedCorotated, mesh.tets.len(), 1e5, 0.4, 1000.0);
    let start = State::at_rest(&mesh.positions);
    let refused = |settings: Settings| Stepper::new(&body, &elasticity, &settings).err();
    assert!(refused(Settings { frame_time: 0.0, ..Settings::default() }).is_some());
    assert!(refused(Settings { tolerance: f64::NAN, ..Settings::default() }).is_some());
    assert!(refused(Settings { substeps: 0, ..Settings::default() }).is_some());
    assert!(refused(Settings { mass_damping: -1.0, ..Settings::default() }).is_some());
    let settings = Settings::default();
    let run = |start: &State, path: &[Vec<DVec3>]| simulate(&body, &elasticity, &settings, start, path);
    assert!(matches!(run(&start, &[vec![]]), Err(SimError::Length { .. })));
    assert!(matches!(run(&start, &[vec![DVec3::NAN]]), Err(SimError::NotFinite { .. })));
    let mut thrown = start.clone();
    thrown.velocities[7].z = f64::INFINITY;
    assert!(matches!(run(&thrown, &[vec![DVec3::ZERO]]), Err(SimError::NotFinite { index: 7, .. })));
    thrown.velocities.pop();
    assert!(matches!(run(&thrown, &[vec![DVec3::ZERO]]), Err(SimError::Length { .. })));
    let motion = run(&start, &[vec![DVec3::ZERO]]).expect("good input");
    let vjp = |d: &[Vec<DVec3>]| simulate_vjp(&body, &elasticity, &settings, &motion, d).map(|_| ());
    assert!(matches!(vjp(&[]), Err(SimError::Length { .. })));
    assert!(matches!(vjp(&[vec![DVec3::ZERO; 3]]), Err(SimError::Length { .. })));
    assert!(matches!(vjp(&[vec![DVec3::NAN; 12]]), Err(SimError::NotFinite { .. })));
}
