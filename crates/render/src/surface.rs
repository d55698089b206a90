//! A mesh and its looks made ready for drawing: everything that does not depend on the pose, built once.

use crate::error::RenderError;
use crate::normals::NormalRecipe;
use crate::silhouette::Topology;
use crate::texture::MipTexture;
use animimic_scene::{AlphaMode, Look, Mesh};
use std::sync::Arc;

/// A drawable surface. Positions are given with each call, so one surface serves all poses and threads.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    /// Number of vertices that positions must have.
    pub vertex_count: usize,
    /// Vertex indices per triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`Surface::looks`] per triangle.
    pub look_of_triangle: Vec<u32>,
    /// Looks; the last one is the default look of triangles that belong to no part. Parts of a surface share them.
    pub looks: Arc<Vec<SurfaceLook>>,
    /// Texture coordinates per vertex; empty if none.
    pub uvs: Vec<[f32; 2]>,
    /// Linear vertex colours; empty if none.
    pub colors: Vec<[f32; 3]>,
    /// How normals follow from positions.
    pub normals: NormalRecipe,
    /// Per triangle: hidden from behind (single-sided looks); empty when no triangle is.
    pub cull_back: Vec<bool>,
    /// Joined vertices and open borders.
    pub topology: Topology,
    /// Whether colours are nothing but vertex colours: no light, no texture.
    pub plain: bool,
    /// Whether no triangle needs light, hence no normals.
    pub unlit: bool,
    /// Whether any look has alpha cutouts.
    pub has_cutouts: bool,
}

/// A look made ready for drawing.
#[derive(Clone, Debug)]
pub struct SurfaceLook {
    /// Linear RGB factor.
    pub base: [f32; 3],
    /// Alpha factor.
    pub alpha: f32,
    /// Emitted light, linear RGB.
    pub emissive: [f32; 3],
    /// Drawn without light.
    pub unlit: bool,
    /// Base colour texture; only where the mesh has texture coordinates.
    pub texture: Option<MipTexture>,
    /// Alpha below which nothing is drawn. Blended looks are drawn opaque.
    pub cutoff: Option<f32>,
}

impl Surface {
    /// Prepares a mesh with its looks (as parts refer to them).
    ///
    /// # Errors
    /// [`RenderError::Mesh`] when indices or attribute lengths do not fit together.
    pub fn new(mesh: &Mesh, looks: &[Look]) -> Result<Self, RenderError> {
        let n = mesh.positions.len();
        check(mesh, n)?;
        let mut look_of_triangle = vec![looks.len() as u32; mesh.triangles.len()];
        for part in &mesh.parts {
            let known = if part.look < looks.len() { part.look } else { looks.len() };
            if let Some(range) = look_of_triangle.get_mut(part.triangles.clone()) {
                range.fill(known as u32);
            }
        }
        let default = Look { double_sided: true, ..Look::default() };
        let all: Vec<&Look> = looks.iter().chain(std::iter::once(&default)).collect();
        let cull_back: Vec<bool> = look_of_triangle.iter().map(|&l| !all[l as usize].double_sided).collect();
        let looks: Vec<SurfaceLook> = all.iter().map(|l| prepare(l, !mesh.uvs.is_empty())).collect();
        Ok(Self {
            vertex_count: n,
            triangles: mesh.triangles.clone(),
            plain: look_of_triangle.iter().all(|&l| looks[l as usize].unlit && looks[l as usize].texture.is_none()),
            unlit: look_of_triangle.iter().all(|&l| all[l as usize].unlit),
            look_of_triangle,
            has_cutouts: looks.iter().any(|l| l.cutoff.is_some()),
            looks: Arc::new(looks),
            uvs: mesh.uvs.iter().map(|uv| [uv.x as f32, uv.y as f32]).collect(),
            colors: mesh.colors.clone(),
            normals: NormalRecipe::new(mesh),
            topology: Topology::new(mesh),
            cull_back: if cull_back.contains(&true) { cull_back } else { Vec::new() },
        })
    }

    /// The look of a triangle.
    pub fn look(&self, triangle: u32) -> &SurfaceLook {
        &self.looks[self.look_of_triangle[triangle as usize] as usize]
    }
}

fn check(mesh: &Mesh, n: usize) -> Result<(), RenderError> {
    if let Some(t) = mesh.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= n)) {
        return Err(RenderError::Mesh(format!("triangle {t} refers to a vertex beyond the last of {n}")));
    }
    for (name, length) in [("texture coordinates", mesh.uvs.len()), ("vertex colours", mesh.colors.len())] {
        if length != 0 && length != n {
            return Err(RenderError::Mesh(format!("{length} {name} for {n} vertices")));
        }
    }
    Ok(())
}

fn prepare(look: &Look, has_uvs: bool) -> SurfaceLook {
    let [r, g, b, alpha] = look.base_color;
    SurfaceLook {
        base: [r, g, b],
        alpha,
        emissive: look.emissive,
        unlit: look.unlit,
        texture: look.texture.as_ref().filter(|_| has_uvs).map(MipTexture::new),
        cutoff: match look.alpha {
            AlphaMode::Mask(cutoff) => Some(cutoff),
            AlphaMode::Opaque | AlphaMode::Blend => None,
        },
    }
}
