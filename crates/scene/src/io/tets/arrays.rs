//! NumPy arrays: `positions` \[vertex, 3\], `tets` \[tet, 4\], and per surface vertex `surface_tet` and `surface_barycentric` \[vertex, 4\].

use super::TetFormat;
use crate::io::SceneError;
use crate::io::npz::{self, Archive, Array, Values};
use crate::{Embedding, TetMesh};

/// The only one that carries the embedding.
pub(super) struct Arrays;

impl TetFormat for Arrays {
    fn extension(&self) -> &'static str {
        "npz"
    }

    fn bytes(&self, mesh: &TetMesh, embedding: &Embedding) -> Result<Vec<u8>, SceneError> {
        let array = |name: &str, shape: Vec<usize>, values| (name.to_owned(), Array { shape, values });
        let positions = mesh.positions.iter().flat_map(|p| p.to_array()).collect();
        let tets = mesh.tets.iter().flatten().copied().collect();
        let barycentric = embedding.barycentric.iter().flatten().copied().collect();
        npz::to_bytes(&Archive {
            arrays: vec![
                array("positions", vec![mesh.positions.len(), 3], Values::F64(positions)),
                array("tets", vec![mesh.tets.len(), 4], Values::U32(tets)),
                array("surface_tet", vec![embedding.tet.len()], Values::U32(embedding.tet.clone())),
                array("surface_barycentric", vec![embedding.barycentric.len(), 4], Values::F64(barycentric)),
            ],
        })
    }
}
