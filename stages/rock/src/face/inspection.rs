//! Inspects a mesh: everything that is wrong with it, where, and its pieces, borders and holes.

use nalgebra::Vector3;

use super::half_edges::{BORDER, CROWDED, HalfEdges, next};
use rockface_core::artefact::Mesh;

/// How often a fault occurs, and where first.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Found {
    /// How often it occurs; 0 where the mesh does not have the fault.
    pub count: usize,
    /// A place of the first, metres, in the frame of the mesh.
    pub place: Option<[f64; 3]>,
}

impl Found {
    fn add(&mut self, place: [f64; 3]) {
        self.count += 1;
        self.place.get_or_insert(place);
    }
}

/// A connected piece of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// Number of triangles.
    pub triangles: usize,
    /// Half-edges on its border or on edges of three or more triangles; 0: it is closed.
    pub open_edges: usize,
    /// Area, square metres.
    pub area_m2: f64,
    /// Sum of the triangles' normals times their areas, square metres.
    pub normal_area: Vector3<f64>,
    /// Volume enclosed, cubic metres; negative where a closed piece is inside out.
    pub volume_m3: f64,
}

/// A closed line of border edges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Border {
    /// The piece it belongs to, by its place in [`Inspection::pieces`].
    pub piece: usize,
    /// Number of edges.
    pub edges: usize,
    /// Length, metres.
    pub length_m: f64,
    /// Its first vertex, metres.
    pub place: [f64; 3],
}

/// Everything that is wrong with a mesh, its pieces and its holes.
#[derive(Debug, Clone, PartialEq)]
pub struct Inspection {
    /// Edges of one triangle.
    pub border_edges: usize,
    /// Edges of three or more triangles.
    pub crowded_edges: Found,
    /// Edges whose two triangles are oriented against each other.
    pub opposed_edges: Found,
    /// Vertices where pieces of surface meet in a point only.
    pub pinched_vertices: Found,
    /// Connected pieces, in the order of their first triangles.
    pub pieces: Vec<Piece>,
    /// All but the longest border of each piece; empty where edges are faulty, for then borders do not close.
    pub holes: Vec<Border>,
}

impl Inspection {
    /// Inspects a mesh whose triangles have three different corners.
    pub fn of(mesh: &Mesh) -> Self {
        let edges = HalfEdges::new(mesh);
        let (piece_of, count) = edges.pieces();
        let (fan_of, fans) = edges.fans();
        let mut found = Self {
            border_edges: edges.twins.iter().filter(|twin| **twin == BORDER).count(),
            crowded_edges: crowded(mesh, &edges),
            opposed_edges: Found::default(),
            pinched_vertices: pinched(mesh, &edges, &fan_of, fans),
            pieces: measure(mesh, &edges, &piece_of, count),
            holes: Vec::new(),
        };
        let opposed = edges.all().filter(|half| edges.is_opposed(*half) && edges.twins[*half as usize] > *half);
        opposed.for_each(|half| found.opposed_edges.add(place(mesh, &edges, half)));
        if found.crowded_edges.count + found.opposed_edges.count == 0 {
            found.holes = holes(borders(mesh, &edges, &piece_of, &fan_of, fans), count);
        }
        found
    }

    /// Volume of the closed pieces, cubic metres; `None` where no piece is closed.
    pub fn closed_volume_m3(&self) -> Option<f64> {
        let closed = || self.pieces.iter().filter(|piece| piece.open_edges == 0);
        closed().next().map(|_| closed().fold(0.0, |sum, piece| sum + piece.volume_m3))
    }

    /// Area and normal area of the open pieces together, square metres; `None` where all are closed.
    pub fn open_area(&self) -> Option<(f64, Vector3<f64>)> {
        let open = || self.pieces.iter().filter(|piece| piece.open_edges > 0);
        let add = |(area, normal): (f64, Vector3<f64>), p: &Piece| (area + p.area_m2, normal + p.normal_area);
        open().next().map(|_| open().fold((0.0, Vector3::zeros()), add))
    }
}

fn place(mesh: &Mesh, edges: &HalfEdges, half: u32) -> [f64; 3] {
    mesh.vertices[edges.origin(half) as usize]
}

/// Each edge once: its half-edges in sorted order differ in their ends.
fn crowded(mesh: &Mesh, edges: &HalfEdges) -> Found {
    let ends = |half: u32| {
        let (a, b) = (edges.origin(half), edges.origin(next(half)));
        (a.min(b), a.max(b))
    };
    let mut found: Vec<(u32, u32)> =
        edges.all().filter(|half| edges.twins[*half as usize] == CROWDED).map(ends).collect();
    found.sort_unstable();
    found.dedup();
    Found { count: found.len(), place: found.first().map(|(a, _)| mesh.vertices[*a as usize]) }
}

fn pinched(mesh: &Mesh, edges: &HalfEdges, fan_of: &[u32], fans: usize) -> Found {
    let mut seen = vec![false; fans];
    let mut fans_at = vec![0u32; mesh.vertices.len()];
    // Fans at an edge of three triangles are split by that edge, which is reported for itself.
    let mut crowded = vec![false; mesh.vertices.len()];
    for half in edges.all() {
        let (fan, vertex) = (fan_of[half as usize] as usize, edges.origin(half) as usize);
        fans_at[vertex] += u32::from(!std::mem::replace(&mut seen[fan], true));
        if edges.twins[half as usize] == CROWDED {
            crowded[vertex] = true;
            crowded[edges.origin(next(half)) as usize] = true;
        }
    }
    let mut found = Found::default();
    let pinched = (0..mesh.vertices.len()).filter(|v| fans_at[*v] > 1 && !crowded[*v]);
    pinched.for_each(|vertex| found.add(mesh.vertices[vertex]));
    found
}

fn measure(mesh: &Mesh, edges: &HalfEdges, piece_of: &[u32], count: usize) -> Vec<Piece> {
    let nothing = Piece { triangles: 0, open_edges: 0, area_m2: 0.0, normal_area: Vector3::zeros(), volume_m3: 0.0 };
    let mut pieces = vec![nothing; count];
    let origin = mesh.vertices.first().map_or_else(Vector3::zeros, |v| Vector3::from(*v));
    for (triangle, piece) in mesh.triangles.iter().zip(piece_of) {
        let [a, b, c] = triangle.map(|i| Vector3::from(mesh.vertices[i as usize]) - origin);
        let normal_area = (b - a).cross(&(c - a)) / 2.0;
        let piece = &mut pieces[*piece as usize];
        piece.triangles += 1;
        piece.area_m2 += normal_area.norm();
        piece.normal_area += normal_area;
        piece.volume_m3 += a.dot(&normal_area) / 3.0;
    }
    for half in edges.all().filter(|half| edges.twin(*half).is_none()) {
        pieces[piece_of[half as usize / 3] as usize].open_edges += 1;
    }
    pieces
}

/// Follows every border: the border edge that leaves a fan comes after the one that enters it.
fn borders(mesh: &Mesh, edges: &HalfEdges, piece_of: &[u32], fan_of: &[u32], fans: usize) -> Vec<Border> {
    let mut leaving = vec![BORDER; fans];
    let on_border = || edges.all().filter(|half| edges.twins[*half as usize] == BORDER);
    on_border().for_each(|half| leaving[fan_of[half as usize] as usize] = half);
    let mut borders = Vec::new();
    for start in on_border() {
        let mut border = Border {
            piece: piece_of[start as usize / 3] as usize,
            edges: 0,
            length_m: 0.0,
            place: place(mesh, edges, start),
        };
        let mut half = start;
        while half != BORDER {
            let end = next(half);
            let step = Vector3::from(place(mesh, edges, end)) - Vector3::from(place(mesh, edges, half));
            // Taking the edge out of the table keeps it from being followed again.
            if std::mem::replace(&mut leaving[fan_of[half as usize] as usize], BORDER) == BORDER {
                break;
            }
            border.edges += 1;
            border.length_m += step.norm();
            half = leaving[fan_of[end as usize] as usize];
        }
        if border.edges > 0 {
            borders.push(border);
        }
    }
    borders
}

/// What is left when each piece has given its longest border.
fn holes(borders: Vec<Border>, pieces: usize) -> Vec<Border> {
    let mut longest = vec![None::<usize>; pieces];
    for (number, border) in borders.iter().enumerate() {
        let best = &mut longest[border.piece];
        if best.is_none_or(|other| borders[other].length_m < border.length_m) {
            *best = Some(number);
        }
    }
    let is_hole = |(number, border): (usize, Border)| (longest[border.piece] != Some(number)).then_some(border);
    borders.into_iter().enumerate().filter_map(is_hole).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::testing::height_mesh;

    fn sheet() -> Mesh {
        height_mesh(8, [0.0, 8.0, 0.0, 8.0], |_, _| 0.0)
    }

    #[test]
    fn a_sheet_with_two_holes_names_them() {
        let mut mesh = sheet();
        // Squares (row, column) are pairs of triangles: one square, and two beside each other.
        let gone = [(2, 2), (5, 4), (5, 5)].map(|(row, column)| row * 8 + column);
        let mut number = 0;
        mesh.triangles.retain(|_| {
            number += 1;
            !gone.contains(&((number - 1) / 2))
        });
        let found = Inspection::of(&mesh);
        assert_eq!((found.pieces.len(), found.border_edges), (1, 32 + 4 + 6));
        let lengths: Vec<f64> = found.holes.iter().map(|hole| hole.length_m).collect();
        assert_eq!(lengths, [4.0, 6.0]);
        assert!((found.pieces[0].area_m2 - 61.0).abs() < 1e-12);
        assert_eq!(found.closed_volume_m3(), None);
    }

    #[test]
    fn faults_are_counted_and_placed() {
        let mut mesh = sheet();
        mesh.vertices.push([0.5, 0.5, 1.0]);
        let tip = mesh.vertices.len() as u32 - 1;
        mesh.triangles.push([mesh.triangles[0][2], mesh.triangles[0][0], tip]);
        let found = Inspection::of(&mesh);
        assert_eq!(found.crowded_edges, Found { count: 1, place: Some([0.0; 3]) });
        assert_eq!(found.pinched_vertices.count, 0);
        let mut mesh = sheet();
        mesh.triangles[0].swap(0, 1);
        let found = Inspection::of(&mesh);
        assert_eq!(found.opposed_edges.count, 2);
        assert!(found.holes.is_empty());
    }

    #[test]
    fn closed_pieces_have_a_signed_volume() {
        let vertices = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        let mut mesh = Mesh { frame: rockface_core::artefact::Frame::World, vertices, triangles, colours: Vec::new() };
        let volume = Inspection::of(&mesh).closed_volume_m3().unwrap();
        assert!((volume - 1.0 / 6.0).abs() < 1e-15);
        mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert!(Inspection::of(&mesh).closed_volume_m3().unwrap() < -0.1);
    }
}
