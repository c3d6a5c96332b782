//! Pictures of surface meshes as PNG, drawn in software: no display, no graphics card, the same bytes on every machine.
//!
//! The view is orthographic, from the front, the left and above (x points aft, y to the right, z up). A depth buffer hides
//! surfaces, light is Lambert's on flat cells, and edges are darkened where cells are large enough to show them.

use moldline_foundation::Vector3;
use moldline_mesh::SurfaceMesh;

use crate::plot::{PlotError, encoded};

const WIDTH: usize = 1600;
const HEIGHT: usize = 1000;
/// Samples of a pixel along each axis.
const SAMPLES: usize = 2;
/// Free border, as a part of the picture.
const MARGIN: f64 = 0.04;
/// Direction towards the eye, and of the light as seen from there: right, up, towards the eye.
const EYE: [f64; 3] = [-0.62, -0.60, 0.50];
const LIGHT: [f64; 3] = [-0.35, 0.55, 0.76];
const BACKGROUND: [u8; 3] = [255; 3];
/// Colours from the least to the greatest value, by equal steps of lightness (a polygon through viridis).
const SCALE: [[f64; 3]; 6] = [
    [68.0, 1.0, 84.0],
    [65.0, 68.0, 135.0],
    [42.0, 120.0, 142.0],
    [34.0, 168.0, 132.0],
    [122.0, 209.0, 81.0],
    [253.0, 231.0, 37.0],
];

/// Draws a mesh. `values`: one of each cell; `range`: the values at both ends of the colours. The bytes of a PNG file.
pub fn png(mesh: &SurfaceMesh, values: &[f64], range: [f64; 2]) -> Result<Vec<u8>, PlotError> {
    let mut canvas = Canvas::new(WIDTH * SAMPLES, HEIGHT * SAMPLES);
    let points = projected(&mesh.vertices, canvas.width, canvas.height);
    for (cell, &value) in mesh.cells.iter().zip(values) {
        let corners: Vec<Vector3> = cell.vertices().iter().map(|&vertex| points[vertex as usize]).collect();
        canvas.cell(&corners, colour(value, range));
    }
    encoded(&canvas.reduced(), WIDTH as u32, HEIGHT as u32)
}

/// Range of values for the colours: from the least to that which 99 % do not exceed; of some width even if all are equal.
pub fn range(values: &[f64]) -> [f64; 2] {
    let mut finite: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    finite.sort_by(f64::total_cmp);
    let Some(&low) = finite.first() else { return [0.0, 1.0] };
    let high = finite[(finite.len() - 1) * 99 / 100];
    if high > low { [low, high] } else { [low, low + 1.0] }
}

/// Points in samples: right, down, and towards the eye. The whole fits into the picture.
fn projected(vertices: &[[f64; 3]], width: usize, height: usize) -> Vec<Vector3> {
    let eye = Vector3::from(EYE).normalize();
    let right = Vector3::new(0.0, 0.0, 1.0).cross(&eye).normalize();
    let up = eye.cross(&right);
    let seen = |point: &[f64; 3]| {
        let point = Vector3::from(*point);
        Vector3::new(right.dot(&point), up.dot(&point), eye.dot(&point))
    };
    let points: Vec<Vector3> = vertices.iter().map(seen).collect();
    let none = Vector3::repeat(f64::INFINITY);
    let (low, high) =
        points.iter().fold((none, -none), |(low, high), point| (low.inf(point), high.sup(point)));
    let size = high - low;
    let [width, height] = [width as f64, height as f64];
    let free = 1.0 - 2.0 * MARGIN;
    let scale = (free * width / size.x).min(free * height / size.y);
    let scale = if scale.is_finite() { scale } else { 1.0 };
    let middle = (low + high) / 2.0;
    let placed = |point: &Vector3| {
        let from = (point - middle) * scale;
        Vector3::new(width / 2.0 + from.x, height / 2.0 - from.y, from.z)
    };
    points.iter().map(placed).collect()
}

/// The colour of a value; grey without one.
fn colour(value: f64, [low, high]: [f64; 2]) -> [f64; 3] {
    let at = ((value - low) / (high - low)).clamp(0.0, 1.0) * (SCALE.len() - 1) as f64;
    if at.is_nan() {
        return [128.0; 3];
    }
    let from = (at as usize).min(SCALE.len() - 2);
    let part = at - from as f64;
    std::array::from_fn(|i| SCALE[from][i] * (1.0 - part) + SCALE[from + 1][i] * part)
}

/// Colour and depth of every sample, row by row from above.
struct Canvas {
    width: usize,
    height: usize,
    colours: Vec<[u8; 3]>,
    depths: Vec<f32>,
}

impl Canvas {
    fn new(width: usize, height: usize) -> Self {
        let samples = width * height;
        Self { width, height, colours: vec![BACKGROUND; samples], depths: vec![f32::NEG_INFINITY; samples] }
    }

    /// A triangle, or a quadrilateral as two.
    fn cell(&mut self, corners: &[Vector3], colour: [f64; 3]) {
        let diagonal = corners[2] - corners[0];
        let other = corners[corners.len() - 1] - corners[1];
        let Some(normal) = diagonal.cross(&other).try_normalize(0.0) else { return };
        // Down points away from up; a surface is lit from both sides.
        let light = normal.x * LIGHT[0] - normal.y * LIGHT[1] + normal.z * LIGHT[2];
        let shade = 0.35 + 0.65 * light.abs();
        let colour = colour.map(|part| part * shade);
        let size = diagonal.xy().norm().min(other.xy().norm());
        // Darkness of the edges: none of cells below 4 samples, full from 16.
        let edges = 0.45 * ((size - 4.0) / 12.0).clamp(0.0, 1.0);
        if let &[a, b, c, d] = corners {
            self.triangle([a, b, c], [true, true, false], colour, edges);
            self.triangle([a, c, d], [false, true, true], colour, edges);
        } else if let &[a, b, c] = corners {
            self.triangle([a, b, c], [true; 3], colour, edges);
        }
    }

    /// A triangle, with lines along those of its edges ab, bc, ca that are `drawn`.
    fn triangle(&mut self, corners: [Vector3; 3], drawn: [bool; 3], colour: [f64; 3], darkness: f64) {
        let [a, b, c] = corners;
        let double_area = (b - a).xy().perp(&(c - a).xy());
        if double_area == 0.0 || !double_area.is_finite() {
            return;
        }
        let low = a.inf(&b).inf(&c);
        let high = a.sup(&b).sup(&c);
        let columns = within(low.x, high.x, self.width);
        // Height over each edge: that of the opposite corner times the barycentric coordinate.
        let heights = [[a, b], [b, c], [c, a]].map(|[from, to]| double_area.abs() / (to - from).xy().norm());
        for row in within(low.y, high.y, self.height) {
            for column in columns.clone() {
                let at = Vector3::new(column as f64 + 0.5, row as f64 + 0.5, 0.0);
                // Of the corners opposite to ab, bc and ca.
                let weights = [[a, b], [b, c], [c, a]]
                    .map(|[from, to]| (to - from).xy().perp(&(at - from).xy()) / double_area);
                if weights.iter().any(|&weight| weight < 0.0) {
                    continue;
                }
                let depth = (weights[1] * a.z + weights[2] * b.z + weights[0] * c.z) as f32;
                let sample = row * self.width + column;
                if depth <= self.depths[sample] {
                    continue;
                }
                let on_edge = (0..3).any(|edge| drawn[edge] && weights[edge] * heights[edge] < 0.75);
                let kept = if on_edge { 1.0 - darkness } else { 1.0 };
                self.depths[sample] = depth;
                self.colours[sample] = colour.map(|part| (part * kept).round() as u8);
            }
        }
    }

    /// The means of the samples of each pixel, as bytes of red, green and blue.
    fn reduced(&self) -> Vec<u8> {
        let (width, height) = (self.width / SAMPLES, self.height / SAMPLES);
        let mut pixels = Vec::with_capacity(3 * width * height);
        for row in 0..height {
            for column in 0..width {
                for part in 0..3 {
                    let samples = (0..SAMPLES * SAMPLES).map(|sample| {
                        let (x, y) = (column * SAMPLES + sample % SAMPLES, row * SAMPLES + sample / SAMPLES);
                        usize::from(self.colours[y * self.width + x][part])
                    });
                    pixels.push((samples.sum::<usize>() / (SAMPLES * SAMPLES)) as u8);
                }
            }
        }
        pixels
    }
}

/// Samples between two coordinates, of `count`.
fn within(low: f64, high: f64, count: usize) -> std::ops::Range<usize> {
    let inside = |x: f64| x.clamp(0.0, count as f64) as usize;
    inside(low.floor())..inside(high.ceil())
}

#[cfg(test)]
mod tests {
    use moldline_mesh::Cell;

    use super::*;

    fn pixels(file: &[u8]) -> Vec<[u8; 3]> {
        let mut reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        bytes.as_chunks::<3>().0.to_vec()
    }

    /// Two squares that face the eye, the second `gap` nearer to it.
    fn squares(gap: f64) -> SurfaceMesh {
        let eye = Vector3::from(EYE).normalize();
        let right = Vector3::new(0.0, 0.0, 1.0).cross(&eye).normalize();
        let up = eye.cross(&right);
        let square = |size: f64, depth: f64| {
            [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
                .map(|[x, y]| -> [f64; 3] { (right * x * size + up * y * size + eye * depth).into() })
        };
        let vertices = [square(1.0, 0.0), square(0.5, gap)].concat();
        SurfaceMesh::new(vertices, vec![Cell::quad(0, 1, 2, 3), Cell::quad(4, 5, 6, 7)], vec![], vec![])
            .unwrap()
    }

    #[test]
    fn a_square_fills_its_area_and_the_nearer_one_hides_the_other() {
        let count = |gap: f64| {
            let pixels = pixels(&png(&squares(gap), &[0.0, 1.0], [0.0, 1.0]).unwrap());
            assert_eq!(pixels.len(), WIDTH * HEIGHT);
            let yellow = pixels.iter().filter(|[red, _, blue]| *red > 100 && *blue < 60).count();
            let white = pixels.iter().filter(|pixel| **pixel == BACKGROUND).count();
            (yellow as f64, (WIDTH * HEIGHT - white) as f64)
        };
        let side = HEIGHT as f64 * (1.0 - 2.0 * MARGIN);
        let (yellow, drawn) = count(0.1);
        // Within a row of pixels along each side, and the darkened edges.
        assert!((drawn - side * side).abs() <= 4.0 * side, "{drawn}");
        assert!((yellow - side * side / 4.0).abs() <= 4.0 * side, "{yellow}");
        assert_eq!(count(-0.1).0, 0.0);
    }

    #[test]
    fn flat_and_missing_values_are_drawn() {
        assert_eq!(range(&[2.0, 2.0]), [2.0, 3.0]);
        assert_eq!(range(&[f64::NAN]), [0.0, 1.0]);
        assert_eq!(colour(f64::NAN, [0.0, 1.0]), [128.0; 3]);
        assert_eq!(colour(9.0, [0.0, 1.0]), SCALE[SCALE.len() - 1]);
        // All points at one place.
        let mut mesh = squares(0.1);
        mesh.vertices.fill([0.0; 3]);
        assert!(pixels(&png(&mesh, &[0.0; 2], [0.0, 1.0]).unwrap()).iter().all(|pixel| *pixel == BACKGROUND));
    }
}
