use super::Overlay;
use animimic_scene::{Asset, Look};

/// Every joint in a colour of its own, mixed by the skin's weights.
pub struct Weights;

impl Overlay for Weights {
    fn name(&self) -> &'static str {
        "weights"
    }

    fn summary(&self) -> &'static str {
        "the surface in colours of its joints, mixed by the skin's weights"
    }

    fn colours_the_surface(&self) -> bool {
        true
    }

    fn repainted(&self, asset: &Asset) -> Option<Asset> {
        Some(colored_by_weights(asset))
    }
}

/// The model with colours of its joints, mixed by weight, instead of its looks.
pub(crate) fn colored_by_weights(asset: &Asset) -> Asset {
    let skin = &asset.rig.skin;
    let color = |joint: usize| {
        // Hues a golden angle apart: neighbours in the list differ most.
        let hue = joint as f64 * 0.618_034 * std::f64::consts::TAU;
        [0.0, 2.1, 4.2].map(|shift| 0.45 + 0.4 * (hue + shift).cos())
    };
    let colors = skin.influences.iter().map(|list| {
        let mut sum = [0.0f64; 3];
        for i in list {
            let c = color(skin.slots[i.slot as usize].joint);
            (0..3).for_each(|k| sum[k] += i.weight * c[k]);
        }
        sum.map(|v| v as f32)
    });
    let mut mesh = asset.mesh.clone();
    mesh.colors = colors.collect();
    mesh.parts.iter_mut().for_each(|p| p.look = 0);
    Asset { mesh, looks: vec![Look { double_sided: true, ..Look::default() }], ..Asset::default() }
}
