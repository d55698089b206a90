//! Circles around places at rest, each of its own radius, and how far inside them a point lies.

use glam::DVec3;

/// Circles per leaf.
const LEAF: usize = 8;

/// Balls in a tree of boxes, for the question which one a point is nearest to in units of its radius.
pub struct Circles {
    balls: Vec<(DVec3, f64)>,
    nodes: Vec<Node>,
}

struct Node {
    lo: DVec3,
    hi: DVec3,
    largest: f64,
    first: usize,
    count: usize,
    children: Option<[u32; 2]>,
}

impl Circles {
    /// Of centres and positive radii.
    pub fn new(mut balls: Vec<(DVec3, f64)>) -> Self {
        let mut nodes = Vec::new();
        if !balls.is_empty() {
            split(&mut balls, 0, &mut nodes);
        }
        Self { balls, nodes }
    }

    /// The least distance to a centre in units of its radius; `reach` where no circle is nearer than that.
    pub fn nearest(&self, x: DVec3, reach: f64) -> f64 {
        let mut best = reach * reach;
        let mut stack = if self.nodes.is_empty() { vec![] } else { vec![(self.nodes[0].least(x), 0u32)] };
        while let Some((least, k)) = stack.pop() {
            let node = &self.nodes[k as usize];
            if least >= best {
                continue;
            }
            match node.children {
                None => {
                    let here = self.balls[node.first..node.first + node.count].iter();
                    best = here.map(|(center, r)| center.distance_squared(x) / (r * r)).fold(best, f64::min);
                }
                // The nearer child comes off the stack first.
                Some(children) => {
                    let mut next = children.map(|c| (self.nodes[c as usize].least(x), c));
                    next.sort_by(|a, b| b.0.total_cmp(&a.0));
                    stack.extend(next);
                }
            }
        }
        best.sqrt()
    }
}

impl Node {
    /// No circle below is nearer to `x`: squared, in units of radii.
    fn least(&self, x: DVec3) -> f64 {
        x.distance_squared(x.clamp(self.lo, self.hi)) / (self.largest * self.largest)
    }
}

fn split(balls: &mut [(DVec3, f64)], first: usize, nodes: &mut Vec<Node>) -> u32 {
    let bounds = |(lo, hi, r): (DVec3, DVec3, f64), b: &(DVec3, f64)| (lo.min(b.0), hi.max(b.0), r.max(b.1));
    let (lo, hi, largest) = balls.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY, 0.0), bounds);
    let index = nodes.len() as u32;
    nodes.push(Node { lo, hi, largest, first, count: balls.len(), children: None });
    if balls.len() > LEAF {
        let axis = (hi - lo).max_position();
        let middle = balls.len() / 2;
        balls.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]));
        let (left, right) = balls.split_at_mut(middle);
        let l = split(left, first, nodes);
        let r = split(right, first + middle, nodes);
        nodes[index as usize].children = Some([l, r]);
    }
    index
}

#[cfg(test)]
mod tests {
    use super::*;
    use animimic_math::gradcheck::SplitMix64;

    #[test]
    fn the_tree_finds_what_looking_at_every_circle_finds() {
        let mut rng = SplitMix64(1);
        let mut random = || rng.uniform();
        let balls: Vec<(DVec3, f64)> =
            (0..500).map(|_| (DVec3::new(random(), random(), random()), 0.002 + 0.1 * random().powi(6))).collect();
        let circles = Circles::new(balls.clone());
        let mut inside = 0;
        for _ in 0..500 {
            let x = DVec3::new(random(), random(), random());
            let all = balls.iter().map(|(c, r)| c.distance_squared(x) / (r * r)).fold(9.0, f64::min).sqrt();
            inside += usize::from(all < 3.0);
            assert_eq!(circles.nearest(x, 3.0), all);
        }
        println!("{inside} of 500 within reach");
        assert!((50..450).contains(&inside));
        assert_eq!(Circles::new(Vec::new()).nearest(DVec3::ZERO, 3.0), 3.0);
    }
}
