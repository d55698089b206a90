//! Vertices without weights take those of the nearest weighted vertex.

use glam::DVec3;

/// Fills every empty list from the nearest vertex (Euclidean; the lower index on a tie) whose list is not empty, and returns how many it filled.
pub fn adopt<T: Clone>(positions: &[DVec3], lists: &mut [Vec<T>]) -> usize {
    let orphans: Vec<usize> = (0..lists.len()).filter(|&v| lists[v].is_empty()).collect();
    let mut donors: Vec<usize> = (0..lists.len()).filter(|&v| !lists[v].is_empty()).collect();
    if orphans.is_empty() || donors.is_empty() {
        return 0;
    }
    arrange(positions, &mut donors, 0);
    for &v in &orphans {
        let mut best = (f64::INFINITY, usize::MAX);
        search(positions, &donors, 0, positions[v], &mut best);
        lists[v] = lists[best.1].clone();
    }
    orphans.len()
}

/// Orders indices as an implicit k-d tree: the median of each range splits it along the axis `depth mod 3`.
fn arrange(positions: &[DVec3], range: &mut [usize], depth: usize) {
    if range.len() <= 1 {
        return;
    }
    let (middle, axis) = (range.len() / 2, depth % 3);
    range.select_nth_unstable_by(middle, |&a, &b| positions[a][axis].total_cmp(&positions[b][axis]).then(a.cmp(&b)));
    let (left, right) = range.split_at_mut(middle);
    arrange(positions, left, depth + 1);
    arrange(positions, &mut right[1..], depth + 1);
}

fn search(positions: &[DVec3], range: &[usize], depth: usize, query: DVec3, best: &mut (f64, usize)) {
    if range.is_empty() {
        return;
    }
    let (middle, axis) = (range.len() / 2, depth % 3);
    let here = range[middle];
    let candidate = (positions[here].distance_squared(query), here);
    if candidate < *best {
        *best = candidate;
    }
    let gap = query[axis] - positions[here][axis];
    let (near, far) =
        if gap < 0.0 { (&range[..middle], &range[middle + 1..]) } else { (&range[middle + 1..], &range[..middle]) };
    search(positions, near, depth + 1, query, best);
    if gap * gap <= best.0 {
        search(positions, far, depth + 1, query, best);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_orphan_takes_the_list_of_the_nearest_vertex_that_has_one() {
        let position =
            |i: usize| DVec3::new((i * 7919 % 101) as f64, (i * 104_729 % 97) as f64, (i * 1299 % 89) as f64);
        let positions: Vec<DVec3> = (0..500).map(position).collect();
        let mut lists: Vec<Vec<usize>> = (0..500).map(|i| if i % 3 == 0 { vec![i] } else { vec![] }).collect();
        let filled = adopt(&positions, &mut lists);
        assert_eq!(filled, 500 - 167);
        for (v, list) in lists.iter().enumerate() {
            let nearest = (0..500)
                .filter(|i| i % 3 == 0)
                .map(|i| positions[i].distance_squared(positions[v]))
                .fold(f64::INFINITY, f64::min);
            assert_eq!(positions[list[0]].distance_squared(positions[v]), nearest, "vertex {v}");
        }
    }
}
