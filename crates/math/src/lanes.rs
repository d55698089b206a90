//! Small vectors and matrices of four problems at a time: one `f64x4` per entry, lane = problem.

pub use wide::f64x4 as Lanes;

/// Problems per batch.
pub const LANES: usize = 4;

/// A 3-vector per lane.
pub type Vec3x4 = [Lanes; 3];

/// The same number in every lane.
#[inline(always)]
pub fn splat(v: f64) -> Lanes {
    Lanes::splat(v)
}

/// a · b.
#[inline(always)]
pub fn dot(a: &Vec3x4, b: &Vec3x4) -> Lanes {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// a × b.
#[inline(always)]
pub fn cross(a: &Vec3x4, b: &Vec3x4) -> Vec3x4 {
    [a[1].mul_sub(b[2], a[2] * b[1]), a[2].mul_sub(b[0], a[0] * b[2]), a[0].mul_sub(b[1], a[1] * b[0])]
}

/// s a.
#[inline(always)]
pub fn scale(a: &Vec3x4, s: Lanes) -> Vec3x4 {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// a + b.
#[inline(always)]
pub fn add(a: &Vec3x4, b: &Vec3x4) -> Vec3x4 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// a − b.
#[inline(always)]
pub fn sub(a: &Vec3x4, b: &Vec3x4) -> Vec3x4 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// A 3×3 matrix per lane, as three columns.
#[derive(Clone, Copy, Debug)]
pub struct Mat3x4 {
    /// Columns.
    pub cols: [Vec3x4; 3],
}

impl Mat3x4 {
    /// All zeros.
    #[inline(always)]
    pub fn zero() -> Self {
        Self { cols: [[splat(0.0); 3]; 3] }
    }

    /// The identity in every lane.
    #[inline(always)]
    pub fn identity() -> Self {
        let (o, i) = (splat(0.0), splat(1.0));
        Self { cols: [[i, o, o], [o, i, o], [o, o, i]] }
    }

    /// From four row-major matrices.
    pub fn from_rows(m: [[[f64; 3]; 3]; LANES]) -> Self {
        let entry = |i: usize, j: usize| Lanes::new([m[0][i][j], m[1][i][j], m[2][i][j], m[3][i][j]]);
        Self { cols: std::array::from_fn(|j| std::array::from_fn(|i| entry(i, j))) }
    }

    /// The matrix of one lane, row-major.
    pub fn lane(&self, lane: usize) -> [[f64; 3]; 3] {
        std::array::from_fn(|i| std::array::from_fn(|j| self.cols[j][i].to_array()[lane]))
    }

    /// Entry (row i, column j).
    #[inline(always)]
    pub fn at(&self, i: usize, j: usize) -> Lanes {
        self.cols[j][i]
    }

    /// M x.
    #[inline(always)]
    pub fn times(&self, x: &Vec3x4) -> Vec3x4 {
        let [a, b, c] = &self.cols;
        std::array::from_fn(|i| a[i].mul_add(x[0], b[i].mul_add(x[1], c[i] * x[2])))
    }

    /// Mᵀ x.
    #[inline(always)]
    pub fn transpose_times(&self, x: &Vec3x4) -> Vec3x4 {
        std::array::from_fn(|j| dot(&self.cols[j], x))
    }

    /// M N.
    #[inline(always)]
    pub fn matmul(&self, n: &Self) -> Self {
        Self { cols: std::array::from_fn(|j| self.times(&n.cols[j])) }
    }

    /// M Nᵀ.
    #[inline(always)]
    pub fn matmul_transpose(&self, n: &Self) -> Self {
        self.matmul(&n.transpose())
    }

    /// Mᵀ.
    #[inline(always)]
    pub fn transpose(&self) -> Self {
        Self { cols: std::array::from_fn(|j| std::array::from_fn(|i| self.cols[i][j])) }
    }

    /// M + N.
    #[inline(always)]
    pub fn plus(&self, n: &Self) -> Self {
        Self { cols: std::array::from_fn(|j| add(&self.cols[j], &n.cols[j])) }
    }

    /// M − N.
    #[inline(always)]
    pub fn minus(&self, n: &Self) -> Self {
        Self { cols: std::array::from_fn(|j| sub(&self.cols[j], &n.cols[j])) }
    }

    /// s M.
    #[inline(always)]
    pub fn scaled(&self, s: Lanes) -> Self {
        Self { cols: std::array::from_fn(|j| scale(&self.cols[j], s)) }
    }

    /// M : N, the Frobenius product.
    #[inline(always)]
    pub fn ddot(&self, n: &Self) -> Lanes {
        dot(&self.cols[0], &n.cols[0]) + dot(&self.cols[1], &n.cols[1]) + dot(&self.cols[2], &n.cols[2])
    }

    /// tr M.
    #[inline(always)]
    pub fn trace(&self) -> Lanes {
        self.cols[0][0] + self.cols[1][1] + self.cols[2][2]
    }

    /// det M.
    #[inline(always)]
    pub fn determinant(&self) -> Lanes {
        dot(&self.cols[0], &cross(&self.cols[1], &self.cols[2]))
    }

    /// Cofactor matrix ∂det/∂M = det(M) M⁻ᵀ, by cross products: regular at every M.
    #[inline(always)]
    pub fn cofactor(&self) -> Self {
        let [a, b, c] = &self.cols;
        Self { cols: [cross(b, c), cross(c, a), cross(a, b)] }
    }

    /// `if_true` in lanes where `mask` is set, `if_false` elsewhere.
    #[inline(always)]
    pub fn select(mask: Lanes, if_true: &Self, if_false: &Self) -> Self {
        Self {
            cols: std::array::from_fn(|j| {
                std::array::from_fn(|i| mask.bitselect(if_true.cols[j][i], if_false.cols[j][i]))
            }),
        }
    }
}
