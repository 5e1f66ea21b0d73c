//! A chart over two axes: frame, grid, ticks, legend, and its layers.

use plotters::chart::{ChartBuilder, ChartContext};
use plotters::coord::cartesian::Cartesian2d;
use plotters::element::{Circle, EmptyElement, PathElement, Polygon, Rectangle, Text};
use plotters::prelude::SVGBackend;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::colour_key::{self, ColourKey};
use super::layer::{Layer, Mark};
use super::scale::{Axis, AxisKind, Scale};
use super::theme::{Anchor, Face, Ink, UNIT, words};
use super::{Area, Inset, failed, legend};
use crate::figure::canvas::Canvas;
use crate::figure::colour_scale::rounded;
use rockface_core::artefact::CodecError;

/// A chart over two axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Axes {
    /// The horizontal axis, with its label below.
    pub x: Axis,
    /// The vertical axis; its label stands over the chart.
    pub y: Axis,
    /// What is drawn, from below.
    pub layers: Vec<Layer>,
    /// The colours of values.
    pub colours: Option<ColourKey>,
}

impl Axes {
    /// Axes on which nothing is drawn yet.
    pub fn new(x: Axis, y: Axis) -> Self {
        Self { x, y, layers: Vec::new(), colours: None }
    }

    /// Signed contributions as lying bars, the first at the top.
    pub fn bars<S: Into<String>>(label: impl Into<String>, rows: impl IntoIterator<Item = (S, f64)>) -> Self {
        let (names, lengths): (Vec<String>, Vec<f64>) = rows.into_iter().map(|(name, x)| (name.into(), x)).unzip();
        Self::new(Axis::linear(label), Axis::named("", names)).with(Layer::new("", Mark::Bars(lengths)))
    }

    /// Adds a layer over those there are.
    #[must_use]
    pub fn with(mut self, layer: Layer) -> Self {
        self.layers.push(layer);
        self
    }

    /// Sets the colours of values.
    #[must_use]
    pub fn colours(self, key: ColourKey) -> Self {
        Self { colours: Some(key), ..self }
    }

    /// The ink of each layer: its own, or the next of the series.
    fn inks(&self) -> Vec<Ink> {
        let mut next = 0;
        let mut ink = |layer: &Layer| {
            let series = Ink::Series(next);
            next += usize::from(layer.takes_a_series_colour());
            let default = if layer.takes_a_series_colour() { series } else { Ink::Rule };
            layer.ink.unwrap_or(default)
        };
        self.layers.iter().map(&mut ink).collect()
    }

    fn scales(&self, [width, height]: [i32; 2]) -> [Scale; 2] {
        let axes = [&self.x, &self.y];
        let log = axes.map(|axis| axis.kind == AxisKind::Log);
        let mut extent = [None::<[f64; 2]>; 2];
        for layer in &self.layers {
            for (ends, found) in extent.iter_mut().zip(layer.extent(log)) {
                *ends = match (*ends, found) {
                    (Some([a, b]), Some([c, d])) => Some([a.min(c), b.max(d)]),
                    (known, found) => known.or(found),
                };
            }
        }
        let exact = self.layers.iter().any(|layer| matches!(layer.mark, Mark::Cells { .. }));
        let counts = [f64::from(width / UNIT) / 75.0, f64::from(height / UNIT) / 45.0].map(|n| n.clamp(2.0, 9.0));
        let x = Scale::of(axes[0], extent[0], counts[0], exact);
        let y = Scale::of(axes[1], extent[1], counts[1], exact);
        [x, if matches!(self.y.kind, AxisKind::Named(_)) { y.downwards() } else { y }]
    }
}

type Chart<'a, 'b> = ChartContext<'b, SVGBackend<'a>, Cartesian2d<Scale, Scale>>;

/// Height of the line that holds the vertical axis' label and of the room under the chart, pixels.
const ABOVE: i32 = 20;
const BELOW: i32 = 42;

pub(super) fn draw(area: &Area, axes: &Axes, insets: &mut Vec<Inset>) -> Result<(), CodecError> {
    let inks = axes.inks();
    let (width, height) = area.dim_in_pixel();
    let mut top = legend::draw(area, axes.layers.iter().zip(&inks).filter(|(layer, _)| !layer.name.is_empty()))?;
    if !axes.y.label.is_empty() || axes.colours.is_some() {
        words(area, &axes.y.label, Face::Label, [0, top], Anchor::Start)?;
        top += ABOVE * UNIT;
    }
    let scales = axes.scales([width as i32 - 60 * UNIT, height as i32 - top - BELOW * UNIT]);
    let labels = scales[1].labels().map(|label| Face::Tick.width(label)).max().unwrap_or(0) + 12 * UNIT;
    let bars = axes.layers.iter().any(|layer| matches!(layer.mark, Mark::Bars(_)));
    let margin = if bars { Face::Tick.width("\u{2212}0.000") } else { 8 * UNIT };
    let key_width = axes.colours.as_ref().map_or(margin, ColourKey::width);
    let bottom = if axes.x.label.is_empty() { BELOW - 16 } else { BELOW };
    let mut chart = ChartBuilder::on(area)
        .margin_top(top + 4 * UNIT)
        .margin_right(key_width)
        .y_label_area_size(labels.min(width as i32 / 2))
        .x_label_area_size(bottom * UNIT)
        .build_cartesian_2d(scales[0].clone(), scales[1].clone())
        .map_err(failed)?;
    let (across, along) = chart.plotting_area().get_pixel_range();
    if let Some(key) = &axes.colours {
        colour_key::draw(area, key, [across.end, along.start, along.end], insets)?;
    }
    mesh(&mut chart, axes)?;
    for (layer, ink) in axes.layers.iter().zip(inks) {
        let painter = Painter { chart: &chart, scales: &scales, ink, key: axes.colours.as_ref() };
        painter.draw(&layer.mark, insets)?;
    }
    Ok(())
}

fn mesh(chart: &mut Chart, axes: &Axes) -> Result<(), CodecError> {
    let cells = axes.layers.iter().any(|layer| matches!(layer.mark, Mark::Cells { .. }));
    let mut mesh = chart.configure_mesh();
    if cells || matches!(axes.x.kind, AxisKind::Named(_)) {
        mesh.disable_x_mesh();
    }
    if cells || matches!(axes.y.kind, AxisKind::Named(_)) {
        mesh.disable_y_mesh();
    }
    mesh.bold_line_style(Ink::Hair.line(10))
        .light_line_style(Ink::Hair.line(4))
        .axis_style(Ink::Faint.line(10))
        .set_all_tick_mark_size(4 * UNIT)
        .label_style(Face::Tick.style())
        .axis_desc_style(Face::Label.style())
        .x_desc(axes.x.label.as_str());
    mesh.draw().map_err(failed)
}

struct Painter<'p, 'a, 'b> {
    chart: &'p Chart<'a, 'b>,
    scales: &'p [Scale; 2],
    ink: Ink,
    key: Option<&'p ColourKey>,
}

impl Painter<'_, '_, '_> {
    fn draw(&self, mark: &Mark, insets: &mut Vec<Inset>) -> Result<(), CodecError> {
        match mark {
            Mark::Line(points) => self.runs(points).into_iter().try_for_each(|run| self.path(run, 18)),
            Mark::Band(points) => self.band(points),
            Mark::Points(points) => points.iter().try_for_each(|point| self.point(*point, self.ink)),
            Mark::Valued(points) => points.iter().try_for_each(|[x, y, value]| {
                let key = self.key()?;
                self.point([*x, *y], Ink::Fixed(key.scale.colour(*value)))
            }),
            Mark::Intervals(points) => points.iter().try_for_each(|interval| self.interval(*interval)),
            Mark::Columns { edges, heights } => self.columns(edges, heights),
            Mark::Bars(lengths) => self.bars(lengths),
            Mark::Cells { x, y, columns, values } => self.cells([*x, *y], *columns, values, insets),
            Mark::AtX(x) if self.scales[0].shows(*x) => self.path(self.scales[1].ends().map(|y| (*x, y)).to_vec(), 12),
            Mark::AtY(y) if self.scales[1].shows(*y) => self.path(self.scales[0].ends().map(|x| (x, *y)).to_vec(), 12),
            Mark::AtX(_) | Mark::AtY(_) => Ok(()),
            Mark::Diagonal => self.diagonal(),
            Mark::Words(texts) => texts.iter().try_for_each(|(x, y, text)| self.words([*x, *y], text)),
        }
    }

    fn key(&self) -> Result<&ColourKey, CodecError> {
        self.key.ok_or_else(|| CodecError::new("values are to be drawn as colours, and the axes have no colour key"))
    }

    fn shows(&self, [x, y]: [f64; 2]) -> bool {
        self.scales[0].shows(x) && self.scales[1].shows(y)
    }

    /// The parts of a line that the axes show.
    fn runs(&self, points: &[[f64; 2]]) -> Vec<Vec<(f64, f64)>> {
        let runs = points.split(|point| !self.shows(*point));
        runs.filter(|run| !run.is_empty()).map(|run| run.iter().map(|[x, y]| (*x, *y)).collect()).collect()
    }

    fn path(&self, points: Vec<(f64, f64)>, width: i32) -> Result<(), CodecError> {
        self.chart.plotting_area().draw(&PathElement::new(points, self.ink.line(width))).map_err(failed)
    }

    fn band(&self, points: &[[f64; 3]]) -> Result<(), CodecError> {
        let shown = |[x, low, high]: &[f64; 3]| {
            let clamped = [low, high].map(|y| self.scales[1].clamped(*y));
            self.scales[0].shows(*x) && clamped.iter().all(|y| self.scales[1].shows(*y))
        };
        for run in points.split(|point| !shown(point)).filter(|run| run.len() > 1) {
            let side = |end: usize| run.iter().map(move |point| (point[0], self.scales[1].clamped(point[end])));
            let outline: Vec<(f64, f64)> = side(1).chain(side(2).rev()).collect();
            self.chart.plotting_area().draw(&Polygon::new(outline, self.ink.area(0.25))).map_err(failed)?;
        }
        Ok(())
    }

    fn point(&self, [x, y]: [f64; 2], ink: Ink) -> Result<(), CodecError> {
        if !self.shows([x, y]) {
            return Ok(());
        }
        if self.key.is_some() && !matches!(ink, Ink::Fixed(_)) {
            let halo = Circle::new((x, y), 5 * UNIT, Ink::Fixed([255; 3]).area(0.9));
            self.chart.plotting_area().draw(&halo).map_err(failed)?;
        }
        self.chart.plotting_area().draw(&Circle::new((x, y), 3 * UNIT, ink.area(0.85))).map_err(failed)
    }

    fn interval(&self, [x, low, high]: [f64; 3]) -> Result<(), CodecError> {
        let ends = [low, high].map(|y| (x, self.scales[1].clamped(y)));
        if !ends.iter().all(|(x, y)| self.shows([*x, *y])) {
            return Ok(());
        }
        self.path(ends.to_vec(), 14)
    }

    fn columns(&self, edges: &[f64], heights: &[f64]) -> Result<(), CodecError> {
        for (sides, height) in edges.windows(2).zip(heights) {
            let [left, right] = [sides[0], sides[1]].map(|x| self.scales[0].clamped(x));
            let [base, top] = [0.0, *height].map(|y| self.scales[1].clamped(y));
            if left < right && top > base {
                let column = Rectangle::new([(left, top), (right, base)], self.ink.area(0.55));
                self.chart.plotting_area().draw(&column).map_err(failed)?;
            }
        }
        Ok(())
    }

    fn bars(&self, lengths: &[f64]) -> Result<(), CodecError> {
        let zero = self.scales[0].clamped(0.0);
        let step = lengths.iter().fold(0.0f64, |most, x| most.max(x.abs())) / 100.0;
        for (row, length) in lengths.iter().enumerate().filter(|(_, length)| length.is_finite()) {
            let ink = if *length < 0.0 { Ink::Series(1) } else { Ink::Series(0) };
            let (place, end) = (row as f64, self.scales[0].clamped(*length));
            let bar = Rectangle::new([(zero, place - 0.32), (end, place + 0.32)], ink.area(0.85));
            self.chart.plotting_area().draw(&bar).map_err(failed)?;
            let style = Face::Tick.style().pos(Pos::new(HPos::Left, VPos::Center));
            let at = EmptyElement::at((end.max(zero), place));
            let step = crate::figure::colour_scale::round_step(step.max(1e-12));
            let label = at + Text::new(rounded(*length, step), (5 * UNIT, 0), style);
            self.chart.plotting_area().draw(&label).map_err(failed)?;
        }
        let line = vec![(zero, -0.5), (zero, lengths.len() as f64 - 0.5)];
        self.chart.plotting_area().draw(&PathElement::new(line, Ink::Faint.line(10))).map_err(failed)
    }

    fn cells(
        &self,
        [x, y]: [[f64; 2]; 2],
        columns: usize,
        values: &[f64],
        insets: &mut Vec<Inset>,
    ) -> Result<(), CodecError> {
        let key = self.key()?;
        let rows = values.len() / columns.max(1);
        if columns == 0 || rows == 0 || rows * columns != values.len() {
            return Err(CodecError(format!("{} values do not fill rows of {columns} cells", values.len())));
        }
        let mut canvas = Canvas::new(columns, rows);
        for (cell, value) in values.iter().enumerate() {
            canvas.fill(cell % columns, cell / columns, 1, 1, key.scale.colour(*value));
        }
        let corner = |x: f64, y: f64| self.chart.plotting_area().map_coordinate(&(x, y));
        let ((left, top), (right, bottom)) = (corner(x[0], y[1]), corner(x[1], y[0]));
        insets.push(Inset { place: [left, top, right - left, bottom - top], png: canvas.to_png()? });
        Ok(())
    }

    fn diagonal(&self) -> Result<(), CodecError> {
        let [[a, b], [c, d]] = [self.scales[0].ends(), self.scales[1].ends()];
        let (low, high) = (a.max(c), b.min(d));
        if low < high { self.path(vec![(low, low), (high, high)], 12) } else { Ok(()) }
    }

    fn words(&self, [x, y]: [f64; 2], text: &str) -> Result<(), CodecError> {
        if !self.shows([x, y]) {
            return Ok(());
        }
        let style = Face::Tick.style().pos(Pos::new(HPos::Left, VPos::Center));
        let element = EmptyElement::at((x, y)) + Text::new(text.to_owned(), (6 * UNIT, 0), style);
        self.chart.plotting_area().draw(&element).map_err(failed)
    }
}
