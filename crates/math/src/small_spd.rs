//! Symmetric positive definite systems of a handful of unknowns.

/// A⁻¹ b by Cholesky; `None` where A is not positive definite. Only the lower triangle of A is read.
pub fn solve_spd<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> Option<[f64; N]> {
    for i in 0..N {
        for j in 0..=i {
            let s = a[i][j] - (0..j).map(|k| a[i][k] * a[j][k]).sum::<f64>();
            if i == j {
                if s.is_nan() || s <= 0.0 {
                    return None;
                }
                a[i][i] = s.sqrt();
            } else {
                a[i][j] = s / a[j][j];
            }
        }
        b[i] = (b[i] - (0..i).map(|k| a[i][k] * b[k]).sum::<f64>()) / a[i][i];
    }
    for i in (0..N).rev() {
        b[i] = (b[i] - (i + 1..N).map(|k| a[k][i] * b[k]).sum::<f64>()) / a[i][i];
    }
    Some(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_definite_system_is_solved_and_an_indefinite_one_refused() {
        let a = [[4.0, 1.0, -1.0], [1.0, 3.0, 0.5], [-1.0, 0.5, 5.0]];
        let x = [1.0, -2.0, 0.25];
        let b = std::array::from_fn(|i| (0..3).map(|j| a[i][j] * x[j]).sum());
        let found = solve_spd(a, b).expect("definite");
        let worst = found.iter().zip(x).map(|(f, x): (&f64, f64)| (f - x).abs()).fold(0.0, f64::max);
        println!("worst error {worst:.1e}");
        assert!(worst < 1e-14);
        assert!(solve_spd([[1.0, 2.0], [2.0, 1.0]], [1.0, 1.0]).is_none());
        assert!(solve_spd([[f64::NAN]], [1.0]).is_none());
    }
}
