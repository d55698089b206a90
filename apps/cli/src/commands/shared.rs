//! Options that several commands have in common.

use animimic::sim::tet::DEFAULT_TETS;

/// What to do with a model that is broken in small ways.
#[derive(clap::Args)]
pub struct Mend {
    /// Mend what is broken in small ways (indices out of range, values that are not finite) and say how much
    #[arg(long)]
    pub repair: bool,
}

/// The body that is simulated.
#[derive(clap::Args)]
pub struct Body {
    /// How many tets are simulated, about
    #[arg(long, value_name = "N", default_value_t = DEFAULT_TETS)]
    pub tets: usize,
    /// Length of the model's diagonal [m]: larger things sway more slowly
    #[arg(long, value_name = "M", default_value_t = 1.0)]
    pub size_m: f64,
}
