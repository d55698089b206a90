//! How soft what is: numbers and presets, for the whole model or by material.

use crate::Error;
use animimic_fit::soft::Tissue;
use animimic_scene::Asset;
use animimic_sim::{Elasticity, Model};

/// Named stiffness: name, Young's modulus [Pa] at a rest diagonal of 1 m, what it is like.
pub const PRESETS: &[(&str, f64, &str)] = &[
    ("flesh", 1e5, "muscle and skin: follows closely, settles at once"),
    ("rubber", 1e6, "a toy: smooth bends, hardly any sway"),
    ("jelly", 1e4, "sways long and far"),
    ("fat", 3e4, "sways and settles"),
];

/// Poisson's ratio of all tissue.
pub const POISSON: f64 = 0.4;
/// Density of all tissue [kg/m³].
pub const DENSITY: f64 = 1000.0;
/// Young's moduli that are taken [Pa].
const RANGE: std::ops::RangeInclusive<f64> = 1e2..=1e9;

/// A stiffness, for one material or for all.
#[derive(Clone, Debug, PartialEq)]
pub struct Softness {
    /// Name of the material that it is for; all where absent.
    pub material: Option<String>,
    /// Young's modulus [Pa].
    pub young: f64,
}

impl std::str::FromStr for Softness {
    type Err = String;

    /// `VALUE` or `MATERIAL=VALUE`, a value being a number of pascals or a preset's name.
    fn from_str(text: &str) -> Result<Self, String> {
        let (material, value) = match text.rsplit_once('=') {
            Some((material, value)) => (Some(material.to_owned()), value),
            None => (None, text),
        };
        Ok(Self { material, young: young(value)? })
    }
}

/// Young's modulus [Pa] of a number of pascals or a preset's name.
///
/// # Errors
/// Neither, or out of range.
pub fn young(text: &str) -> Result<f64, String> {
    let preset = PRESETS.iter().find(|p| p.0 == text).map(|p| p.1);
    preset.or_else(|| text.parse().ok()).filter(|y| RANGE.contains(y)).ok_or_else(|| {
        let names: Vec<&str> = PRESETS.iter().map(|p| p.0).collect();
        format!("{text} is neither {} nor a number of pascals from 1e2 to 1e9", names.join(", "))
    })
}

/// The material of a model's tets: of every tet that of the surface in it, or next to it.
pub(super) fn elasticity(asset: &Asset, tissue: &Tissue, softness: &[Softness]) -> Result<Elasticity, Error> {
    let mut youngs = vec![PRESETS[0].1; asset.looks.len().max(1)];
    for s in softness {
        match &s.material {
            None => youngs.fill(s.young),
            Some(name) => {
                let mut named = (0..asset.looks.len()).filter(|&l| asset.looks[l].name == *name).peekable();
                if named.peek().is_none() {
                    let known: Vec<&str> = asset.looks.iter().map(|l| l.name.as_str()).collect();
                    return Err(Error::Input(format!("no material named {name}: there are {}", known.join(", "))));
                }
                named.for_each(|l| youngs[l] = s.young);
            }
        }
    }
    let tets = tissue.body.tets.len();
    let one = Elasticity::uniform(Model::GuardedCorotated, tets, youngs[0], POISSON, DENSITY);
    if youngs.iter().all(|y| *y == youngs[0]) {
        return Ok(one);
    }
    let ln_youngs = youngs.iter().map(|y| y.ln()).collect();
    Ok(Elasticity { cluster: looks_of_tets(asset, tissue), ln_youngs, ..one })
}

/// The look of every tet.
fn looks_of_tets(asset: &Asset, tissue: &Tissue) -> Vec<u32> {
    let tets = &tissue.cage.mesh.tets;
    let mut votes = vec![vec![0usize; asset.looks.len()]; tets.len()];
    for part in &asset.mesh.parts {
        part.vertices.clone().for_each(|v| votes[tissue.cage.embedding.tet[v] as usize][part.look] += 1);
    }
    let most = |v: &Vec<usize>| (0..v.len()).filter(|&l| v[l] > 0).max_by_key(|&l| (v[l], usize::MAX - l));
    let mut look: Vec<Option<usize>> = votes.iter().map(most).collect();
    // From the surface inwards, through common vertices.
    let mut at_vertex: Vec<Option<usize>> = vec![None; tissue.cage.mesh.positions.len()];
    loop {
        for (tet, l) in tets.iter().zip(&look).filter(|(_, l)| l.is_some()) {
            tet.iter().for_each(|&v| at_vertex[v as usize] = at_vertex[v as usize].or(*l));
        }
        let mut changed = false;
        for (tet, l) in tets.iter().zip(&mut look).filter(|(_, l)| l.is_none()) {
            *l = tet.iter().find_map(|&v| at_vertex[v as usize]);
            changed |= l.is_some();
        }
        if !changed {
            break;
        }
    }
    look.into_iter().map(|l| l.unwrap_or(0) as u32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stiffness_is_a_number_or_a_presets_name_for_all_or_for_a_material() {
        assert_eq!("jelly".parse(), Ok(Softness { material: None, young: 1e4 }));
        assert_eq!("a=b=2e5".parse(), Ok(Softness { material: Some("a=b".into()), young: 2e5 }));
        for wrong in ["stone", "0", "nan", "1e12", "Hair=", "-5"] {
            let error = wrong.parse::<Softness>().unwrap_err();
            assert!(error.contains("flesh"), "{error}");
        }
    }
}
