//! Linear frames of beam elements in space.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3, Vector6};

use super::element::{self, Matrix12};
use calibrig_model::{Beam, BeamError, Section};

/// Why a frame cannot be built or solved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum FrameError {
    /// The flexible link is wrong.
    Beam(BeamError),
    /// Both ends in one place, or the section's second axis along the element.
    Degenerate,
    /// Infinite stiffness other than in shear, or one that is not positive: there is no stiffness matrix.
    NotElastic,
    /// It can move without being strained.
    Mechanism,
}

impl From<BeamError> for FrameError {
    fn from(error: BeamError) -> Self {
        Self::Beam(error)
    }
}

#[derive(Debug, Clone)]
struct Element {
    nodes: [usize; 2],
    /// In the frame's axes.
    stiffness: Matrix12,
    frame_from_element: Matrix3<f64>,
    length: f64,
}

/// A frame: nodes with six degrees of freedom, beam elements, supports and loads, all in one system of axes.
#[derive(Debug, Clone, Default)]
pub(super) struct Frame {
    nodes: Vec<Vector3<f64>>,
    elements: Vec<Element>,
    fixed: Vec<[bool; 6]>,
    loads: Vec<Vector6<f64>>,
}

/// A loaded frame at rest, one entry a node: along x, y, z, then about them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FrameSolution {
    /// m, rad
    pub displacements: Vec<Vector6<f64>>,
    /// What the supports do to the frame, N and N m; zero (but for rounding) where nothing is fixed.
    pub reactions: Vec<Vector6<f64>>,
}

/// A frame reduced to some of its nodes, six rows each: `stiffness · displacements = load + forces there`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CondensedFrame {
    /// N/m, N, N m
    pub stiffness: DMatrix<f64>,
    /// What the loads of all nodes come to, N and N m.
    pub load: DVector<f64>,
}

impl Frame {
    /// Adds a node at `at` (m) and gives its index.
    pub fn add_node(&mut self, at: Vector3<f64>) -> usize {
        self.nodes.push(at);
        self.fixed.push([false; 6]);
        self.loads.push(Vector6::zeros());
        self.nodes.len() - 1
    }

    /// Joins two nodes rigidly by a uniform beam, whose section's second axis points to the side of `second_axis`; gives its index.
    pub fn add_element(
        &mut self,
        from: usize,
        to: usize,
        section: &Section,
        second_axis: &Vector3<f64>,
    ) -> Result<usize, FrameError> {
        let run = self.nodes[to] - self.nodes[from];
        let along = run.try_normalize(0.0).ok_or(FrameError::Degenerate)?;
        let across = second_axis - along.dot(second_axis) * along;
        let second = across.try_normalize(1e-9 * second_axis.norm()).ok_or(FrameError::Degenerate)?;
        let frame_from_element = Matrix3::from_columns(&[along, second, along.cross(&second)]);

        let elastic = |stiffness: f64| stiffness > 0.0 && stiffness.is_finite();
        let [about_second, about_third] = section.bending;
        if ![section.axial, section.torsion, about_second, about_third].into_iter().all(elastic)
            || !section.shear.into_iter().all(|s| s > 0.0)
        {
            return Err(FrameError::NotElastic);
        }
        let turn = element::turn(&frame_from_element);
        let length = run.norm();
        let stiffness = turn * element::stiffness(section, length) * turn.transpose();
        self.elements.push(Element { nodes: [from, to], stiffness, frame_from_element, length });
        Ok(self.elements.len() - 1)
    }

    /// A beam at the joint variable `q`, free at both ends and loaded by its own weight in `gravity` (m/s²), in the link's frame, with `pieces`
    /// elements a segment (at least one); with its first and its last node.
    pub fn of_beam(
        beam: &Beam,
        q: f64,
        pieces: usize,
        gravity: &Vector3<f64>,
    ) -> Result<(Self, usize, usize), FrameError> {
        let pieces = pieces.max(1);
        let mut second_axis = Vector3::zeros();
        second_axis[beam.run.axes()[1]] = 1.0;
        let mut frame = Self::default();
        let root = frame.add_node(beam.point(0.0, q));
        let mut tip = root;
        let mut from_root = 0.0;
        for (segment, length) in beam.segments.iter().zip(beam.lengths(q)?) {
            for piece in 1..=pieces {
                let at = from_root + length * piece as f64 / pieces as f64;
                let next = frame.add_node(beam.point(at, q));
                let element = frame.add_element(tip, next, &segment.section, &second_axis)?;
                frame.add_uniform_load(element, &(segment.section.mass_per_length * gravity));
                tip = next;
            }
            from_root += length;
        }
        Ok((frame, root, tip))
    }

    /// Holds those of a node's displacements and rotations that are marked.
    pub fn fix(&mut self, node: usize, fixed: [bool; 6]) {
        self.fixed[node] = fixed;
    }

    /// Holds a node.
    pub fn clamp(&mut self, node: usize) {
        self.fix(node, [true; 6]);
    }

    /// Adds a force and a moment (N, N m) at a node.
    pub fn add_load(&mut self, node: usize, load: &Vector6<f64>) {
        self.loads[node] += load;
    }

    /// Adds a uniform force per length (N/m, in the frame's axes) along an element.
    fn add_uniform_load(&mut self, element: usize, force: &Vector3<f64>) {
        let element = &self.elements[element];
        let load = element::turn(&element.frame_from_element)
            * element::uniform_load(&element.frame_from_element.tr_mul(force), element.length);
        for (half, node) in element.nodes.into_iter().enumerate() {
            self.loads[node] += load.fixed_rows::<6>(6 * half);
        }
    }

    /// The stiffness of all nodes, without supports: six rows and columns a node.
    fn stiffness(&self) -> DMatrix<f64> {
        let mut stiffness = DMatrix::zeros(6 * self.nodes.len(), 6 * self.nodes.len());
        for element in &self.elements {
            for (i, row) in element.nodes.into_iter().enumerate() {
                for (j, column) in element.nodes.into_iter().enumerate() {
                    let mut block = stiffness.fixed_view_mut::<6, 6>(6 * row, 6 * column);
                    block += element.stiffness.fixed_view::<6, 6>(6 * i, 6 * j);
                }
            }
        }
        stiffness
    }

    fn load(&self) -> DVector<f64> {
        DVector::from_iterator(6 * self.nodes.len(), self.loads.iter().flatten().copied())
    }

    /// The degrees of freedom that no support holds.
    fn free(&self) -> impl Iterator<Item = usize> + '_ {
        self.fixed.iter().flatten().enumerate().filter(|(_, fixed)| !**fixed).map(|(dof, _)| dof)
    }

    /// The frame at rest under its loads, to first order.
    pub fn solve(&self) -> Result<FrameSolution, FrameError> {
        let (stiffness, load) = (self.stiffness(), self.load());
        let free: Vec<usize> = self.free().collect();
        let found = solve_elastic(
            &select(&stiffness, &free, &free),
            &DMatrix::from_fn(free.len(), 1, |i, _| load[free[i]]),
        )?;
        let mut displacements = DVector::zeros(load.len());
        for (dof, value) in free.iter().zip(&found) {
            displacements[*dof] = *value;
        }
        let reactions = &stiffness * &displacements - load;
        let by_node =
            |v: &DVector<f64>| v.as_slice().chunks_exact(6).map(Vector6::from_column_slice).collect();
        Ok(FrameSolution { displacements: by_node(&displacements), reactions: by_node(&reactions) })
    }

    /// Static (Guyan) condensation to the nodes `kept`, in that order; exact in statics. Supports of the other nodes hold, those of kept
    /// nodes are left to whoever uses the result.
    pub fn condense(&self, kept: &[usize]) -> Result<CondensedFrame, FrameError> {
        let (stiffness, load) = (self.stiffness(), self.load());
        let ends: Vec<usize> = kept.iter().flat_map(|node| 6 * node..6 * node + 6).collect();
        let inner: Vec<usize> = self.free().filter(|dof| !kept.contains(&(dof / 6))).collect();
        let mut condensed =
            CondensedFrame { stiffness: select(&stiffness, &ends, &ends), load: load.select_rows(&ends) };
        if inner.is_empty() {
            return Ok(condensed);
        }
        let coupling = select(&stiffness, &inner, &ends);
        let mut sides = coupling.clone().insert_column(ends.len(), 0.0);
        sides.set_column(ends.len(), &load.select_rows(&inner));
        let solved = solve_elastic(&select(&stiffness, &inner, &inner), &sides)?;
        condensed.stiffness -= coupling.tr_mul(&solved.columns(0, ends.len()));
        condensed.load -= coupling.tr_mul(&solved.column(ends.len()));
        Ok(condensed)
    }
}

fn select(matrix: &DMatrix<f64>, rows: &[usize], columns: &[usize]) -> DMatrix<f64> {
    DMatrix::from_fn(rows.len(), columns.len(), |i, j| matrix[(rows[i], columns[j])])
}

/// Solves with a symmetric matrix that is positive-definite unless something moves without strain.
fn solve_elastic(stiffness: &DMatrix<f64>, sides: &DMatrix<f64>) -> Result<DMatrix<f64>, FrameError> {
    let cholesky = stiffness.clone().cholesky().ok_or(FrameError::Mechanism)?;
    // What a pivot is left with of its own diagonal entry: rounding alone where a motion has no stiffness.
    let factor = cholesky.l_dirty();
    let held = (0..stiffness.nrows()).all(|i| factor[(i, i)].powi(2) > 1e-13 * stiffness[(i, i)]);
    if held { Ok(cholesky.solve(sides)) } else { Err(FrameError::Mechanism) }
}
