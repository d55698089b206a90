//! Named ways to fit: a preset is one line here and one arm where motions are found.

/// A way to fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preset {
    /// Tracking with several hypotheses, joint refinement, polish.
    #[default]
    Default,
    /// The paper's own recipe.
    Reference,
}

impl Preset {
    /// All presets, in the order in which they are listed.
    pub const ALL: [Preset; 2] = [Preset::Default, Preset::Reference];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Preset::Default => "default",
            Preset::Reference => "reference",
        }
    }

    /// What it does, in one line.
    pub fn summary(self) -> &'static str {
        match self {
            Preset::Default => "second-order solvers: tracking with several hypotheses, joint refinement, polish",
            Preset::Reference => "the paper's recipe, for comparison: Adam on 6D rotations, 50 + 200 iterations",
        }
    }
}

impl std::fmt::Display for Preset {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for Preset {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|p| p.name() == text);
        found.ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|p| p.name()).collect();
            format!("there is no preset {text}: use one of {}", names.join(", "))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_is_found_by_its_name_and_no_other() {
        for preset in Preset::ALL {
            assert_eq!(preset.to_string().parse(), Ok(preset));
        }
        let error = "fastest".parse::<Preset>().expect_err("there is none");
        assert!(error.contains("default, reference"), "{error}");
    }
}
