use super::shared::Mend;
use crate::{Common, out};
use animimic::sim::tet::DEFAULT_TETS;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Tet {
    /// The model: any triangle mesh, closed or not
    model: PathBuf,
    /// Where the tets go: .vtu (ParaView), .msh (Gmsh) or .npz (NumPy, with the surface's coordinates in the tets)
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// About how many tets
    #[arg(long, value_name = "N", default_value_t = DEFAULT_TETS)]
    tets: usize,
    #[command(flatten)]
    mend: Mend,
}

impl Tet {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let json = animimic::tet::tet_files(&self.model, &self.out, self.tets, self.mend.repair)?.to_json();
        out::print(common, &json, || out::lines(&json))
    }
}
