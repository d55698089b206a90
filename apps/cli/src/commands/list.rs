use crate::{Common, out};

#[derive(clap::Args)]
pub struct List {
    /// What to list
    kind: Kind,
}

#[derive(clap::ValueEnum, Clone, Copy)]
enum Kind {
    /// Model formats that can be read
    Formats,
    /// Measures of quality
    Metrics,
    /// Camera presets
    Cameras,
    /// Ways to get masks, tracks and depth
    Cues,
    /// Ways to find the motion
    Presets,
    /// Ways to give a model a skeleton
    Riggers,
    /// Constitutive models of soft tissue
    Models,
    /// Ways to deliver motion that goes beyond the skeleton
    Physics,
    /// Services and programs that make a video of a still
    Providers,
    /// What `render` can show beside a model's looks
    Overlays,
}

impl List {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let rows: Vec<(String, String)> = match self.kind {
            Kind::Formats => animimic::scene::io::formats()
                .iter()
                .map(|f| (f.name().to_owned(), format!("{} (.{})", f.summary(), f.extensions().join(", ."))))
                .collect(),
            Kind::Metrics => {
                animimic::metrics::METRICS.iter().map(|m| (m.name().to_owned(), m.definition().to_owned())).collect()
            }
            Kind::Cameras => animimic::camera::PRESETS
                .iter()
                .map(|p| (format!("preset:{}", p.name), p.summary.to_owned()))
                .collect(),
            Kind::Cues => {
                animimic::CUE_PROVIDERS.iter().map(|p| (p.name().to_owned(), p.summary().to_owned())).collect()
            }
            Kind::Presets => {
                animimic::Preset::ALL.iter().map(|p| (p.name().to_owned(), p.summary().to_owned())).collect()
            }
            Kind::Physics => {
                animimic::physics::ENCODINGS.iter().map(|e| (e.name().to_owned(), e.summary().to_owned())).collect()
            }
            Kind::Providers => animimic::generate::PROVIDERS
                .iter()
                .map(|p| (p.about().name.to_owned(), p.about().summary.to_owned()))
                .collect(),
            Kind::Overlays => animimic::turntable::overlays::OVERLAYS
                .iter()
                .map(|o| (o.name().to_owned(), o.summary().to_owned()))
                .collect(),
            Kind::Riggers => {
                animimic::RIGGERS.iter().map(|r| (r.name().to_owned(), r.summary().to_owned())).collect()
            }
            Kind::Models => {
                animimic::sim::Model::ALL.iter().map(|m| (m.name().to_owned(), m.about().to_owned())).collect()
            }
        };
        let json = rows.iter().map(|(name, words)| serde_json::json!({"name": name, "summary": words})).collect();
        out::print(common, &serde_json::Value::Array(json), || {
            rows.iter().map(|(name, words)| format!("{name:26} {words}\n")).collect()
        })
    }
}
