//! Binary images: connected components, distances.

/// A connected region of set pixels (4-neighbourhood).
#[derive(Clone, Debug)]
pub struct Region {
    /// Pixel indices, in the order of discovery.
    pub pixels: Vec<u32>,
    /// Smallest and largest column.
    pub x: (usize, usize),
    /// Smallest and largest row.
    pub y: (usize, usize),
}

impl Region {
    /// Whether the region reaches the edge of the image.
    pub fn touches_border(&self, width: usize, height: usize) -> bool {
        self.x.0 == 0 || self.y.0 == 0 || self.x.1 + 1 == width || self.y.1 + 1 == height
    }
}

/// Connected regions, largest first (equal sizes: topmost first).
pub fn regions(set: &[bool], width: usize) -> Vec<Region> {
    let height = set.len() / width.max(1);
    let mut seen = vec![false; set.len()];
    let mut list = Vec::new();
    for start in 0..set.len() {
        if !set[start] || seen[start] {
            continue;
        }
        seen[start] = true;
        let mut region = Region { pixels: vec![start as u32], x: (width, 0), y: (height, 0) };
        let mut next = 0;
        while next < region.pixels.len() {
            let i = region.pixels[next] as usize;
            next += 1;
            let (x, y) = (i % width, i / width);
            region.x = (region.x.0.min(x), region.x.1.max(x));
            region.y = (region.y.0.min(y), region.y.1.max(y));
            let mut visit = |j: usize| {
                if set[j] && !seen[j] {
                    seen[j] = true;
                    region.pixels.push(j as u32);
                }
            };
            if x > 0 {
                visit(i - 1);
            }
            if x + 1 < width {
                visit(i + 1);
            }
            if y > 0 {
                visit(i - width);
            }
            if y + 1 < height {
                visit(i + width);
            }
        }
        list.push(region);
    }
    list.sort_by_key(|r| std::cmp::Reverse(r.pixels.len()));
    list
}

/// Distance of set pixels to the nearest unset one [px], by the 3–4 chamfer (within 8 % of Euclid's); the outside of the
/// image counts as set.
pub fn depth(set: &[bool], width: usize) -> Vec<f32> {
    const FAR: i32 = i32::MAX / 2;
    let height = set.len() / width.max(1);
    let mut d: Vec<i32> = set.iter().map(|&s| if s { FAR } else { 0 }).collect();
    for y in 0..height {
        for x in 0..width {
            let i = y * width + x;
            let mut v = d[i];
            if x > 0 {
                v = v.min(d[i - 1] + 3);
            }
            if y > 0 {
                v = v.min(d[i - width] + 3);
                if x > 0 {
                    v = v.min(d[i - width - 1] + 4);
                }
                if x + 1 < width {
                    v = v.min(d[i - width + 1] + 4);
                }
            }
            d[i] = v;
        }
    }
    for y in (0..height).rev() {
        for x in (0..width).rev() {
            let i = y * width + x;
            let mut v = d[i];
            if x + 1 < width {
                v = v.min(d[i + 1] + 3);
            }
            if y + 1 < height {
                v = v.min(d[i + width] + 3);
                if x > 0 {
                    v = v.min(d[i + width - 1] + 4);
                }
                if x + 1 < width {
                    v = v.min(d[i + width + 1] + 4);
                }
            }
            d[i] = v;
        }
    }
    d.into_iter().map(|v| v as f32 / 3.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_and_depths_of_a_square_and_a_dot() {
        let set: Vec<bool> = (0..20 * 10)
            .map(|i| (2..9).contains(&(i % 20)) && (1..8).contains(&(i / 20)) || i == 15 + 20 * 4)
            .collect();
        let found = regions(&set, 20);
        assert_eq!((found.len(), found[0].pixels.len(), found[0].x, found[0].y), (2, 49, (2, 8), (1, 7)));
        assert!(!found[0].touches_border(20, 10));
        let d = depth(&set, 20);
        assert_eq!((d[5 + 20 * 4], d[2 + 20], d[0]), (4.0, 1.0, 0.0));
    }
}
