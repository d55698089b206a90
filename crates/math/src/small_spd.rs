//! Symmetric positive definite systems of a handful of unknowns.

/// A⁻¹ b by Cholesky; `None` where A is not positive definite. Only the lower triangle of A is read.
pub fn solve_spd<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> Option<[f64; N]> {
    solve_in_place(&mut a, &mut b).then_some(b)
}

/// The same for a number of unknowns that is not known beforehand.
pub fn solve_spd_of_any_size(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Option<Vec<f64>> {
    solve_in_place(&mut a, &mut b).then_some(b)
}

/// Overwrites b by A⁻¹ b, and the lower triangle of A by its factor; whether A is positive definite.
#[inline(always)]
fn solve_in_place<Row: AsRef<[f64]> + AsMut<[f64]>>(a: &mut [Row], b: &mut [f64]) -> bool {
    let n = b.len();
    let at = |a: &[Row], i: usize, j: usize| a[i].as_ref()[j];
    for i in 0..n {
        for j in 0..=i {
            let s = at(a, i, j) - (0..j).map(|k| at(a, i, k) * at(a, j, k)).sum::<f64>();
            if i == j {
                if s.is_nan() || s <= 0.0 {
                    return false;
                }
                a[i].as_mut()[i] = s.sqrt();
            } else {
                a[i].as_mut()[j] = s / at(a, j, j);
            }
        }
        b[i] = (b[i] - (0..i).map(|k| at(a, i, k) * b[k]).sum::<f64>()) / at(a, i, i);
    }
    for i in (0..n).rev() {
        b[i] = (b[i] - (i + 1..n).map(|k| at(a, k, i) * b[k]).sum::<f64>()) / at(a, i, i);
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_definite_system_is_solved_and_an_indefinite_one_refused() {
        let a = [[4.0, 1.0, -1.0], [1.0, 3.0, 0.5], [-1.0, 0.5, 5.0]];
        let x = [1.0, -2.0, 0.25];
        let b: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| a[i][j] * x[j]).sum());
        let found = solve_spd(a, b).expect("definite");
        let worst = found.iter().zip(x).map(|(f, x): (&f64, f64)| (f - x).abs()).fold(0.0, f64::max);
        println!("worst error {worst:.1e}");
        assert!(worst < 1e-14);
        let of_any_size = solve_spd_of_any_size(a.iter().map(|row| row.to_vec()).collect(), b.to_vec());
        assert_eq!(of_any_size.as_deref(), Some(&found[..]));
        assert!(solve_spd([[1.0, 2.0], [2.0, 1.0]], [1.0, 1.0]).is_none());
        assert!(solve_spd([[f64::NAN]], [1.0]).is_none());
    }
}
