//! Batch renderers: what draws.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use decouplegs::render::FrameStatistics;
use decouplegs::session::{BatchRenderer as EngineViewer, HostImages, Session};
use decouplegs_sharing::{Cuda, InteropError};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::array::to_numpy;
use crate::camera::Camera;
use crate::drawing::{Layers, Views, draw};
use crate::error::{of_interop, of_session, value_error};
use crate::images::{Frame, Images};
use crate::lent::{CudaLender, addresses, lender};
use crate::lidar::{Lidar, motion_of, options_of, points_of, to_dict};
use crate::pose::pose_of;
use crate::statistics::Statistics;
use crate::world::World;

/// Draws worlds of one session.
#[pyclass(frozen, generic, module = "decouplegs")]
pub struct BatchRenderer {
    state: Mutex<State>,
    /// Statistics of the last call, outside of the state, so that they can be read during a draw.
    statistics: Mutex<Vec<Statistics>>,
    /// Lender for CUDA and the number of the device there, if images are shared.
    lender: Option<(Arc<CudaLender>, i32)>,
}

struct State {
    renderer: EngineViewer,
    bytes: HostImages,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

type GivenViews<'py> = Vec<(Bound<'py, World>, Vec<Bound<'py, Camera>>)>;

fn copied(views: &Bound<'_, PyAny>) -> PyResult<Views> {
    let views: GivenViews<'_> = views.extract().map_err(|error| {
        PyTypeError::new_err(format!(
            "views: expected a list of pairs, each of a World and a list of Cameras: {error}"
        ))
    })?;
    if views.is_empty() {
        return Err(value_error(
            "views: expected at least one (world, cameras)".to_owned(),
        ));
    }
    let copy = |(world, cameras): &(Bound<'_, World>, Vec<Bound<'_, Camera>>)| {
        let cameras = cameras
            .iter()
            .map(|camera| camera.get().inner.clone())
            .collect();
        (world.get().lock().clone(), cameras)
    };
    Ok(Views(views.iter().map(copy).collect()))
}

impl BatchRenderer {
    pub fn new(session: &Session, cuda: Option<&Arc<Cuda>>) -> Result<Self, InteropError> {
        let state = State {
            renderer: session.batch_renderer(),
            bytes: HostImages::default(),
        };
        let lender = cuda
            .map(|cuda| Ok::<_, InteropError>((lender(session, cuda)?, cuda.ordinal())))
            .transpose()?;
        Ok(Self {
            state: Mutex::new(state),
            statistics: Mutex::default(),
            lender,
        })
    }

    fn keep(&self, frames: &[FrameStatistics]) {
        *lock(&self.statistics) = frames.iter().map(Statistics::from_frame).collect();
    }

    /// Draws to the host, without the interpreter's lock.
    fn drawn(
        &self,
        py: Python<'_>,
        views: &Views,
        groups: &[Vec<(usize, usize)>],
    ) -> PyResult<Vec<Layers>> {
        let drawn = py.detach(|| {
            let mut state = lock(&self.state);
            let State { renderer, bytes } = &mut *state;
            draw(renderer, views, groups, bytes)
        });
        let (layers, statistics) = drawn.map_err(|error| of_session(&error))?;
        self.keep(&statistics);
        Ok(layers)
    }

    /// Draws to the host, a group for each view. Shape of its colors: cameras, rows, columns.
    fn by_view(&self, py: Python<'_>, views: &Views) -> PyResult<Vec<([usize; 3], Layers)>> {
        let mut groups = vec![Vec::new(); views.0.len()];
        views
            .indices()
            .into_iter()
            .for_each(|index| groups[index.0].push(index));
        let mut shapes = Vec::with_capacity(groups.len());
        for (view, group) in groups.iter().enumerate() {
            let Some(&first) = group.first() else {
                return Err(value_error(format!(
                    "views[{view}]: expected at least one camera"
                )));
            };
            let [width, height] = views.size_px(first);
            if let Some(&other) = group
                .iter()
                .find(|index| views.size_px(**index) != [width, height])
            {
                let [other_width, other_height] = views.size_px(other);
                return Err(value_error(format!(
                    "views[{view}]: its images are one array, and its cameras are of {width}x{height} and \
                     {other_width}x{other_height}: give those of another size as a view of their own, of the same world"
                )));
            }
            shapes.push([group.len(), height as usize, width as usize]);
        }
        Ok(shapes
            .into_iter()
            .zip(self.drawn(py, views, &groups)?)
            .collect())
    }

    /// Draws into memory that CUDA shares.
    fn drawn_on_device(
        &self,
        py: Python<'_>,
        views: &Views,
        (lender, ordinal): &(Arc<CudaLender>, i32),
    ) -> PyResult<Vec<Frame>> {
        let drawn = py.detach(|| {
            let mut state = lock(&self.state);
            lender.collect().map_err(|error| of_interop(&error))?;
            let (taken, statistics) = state
                .renderer
                .draw_on_device(&views.borrowed())
                .map_err(|error| of_session(&error))?;
            let frames = taken.into_iter().map(|taken| {
                let (drawn, ranges) = (taken.frame().value(), taken.ranges().to_vec());
                let loan = lender.lend(taken, drawn);
                let addresses = addresses(lender, &loan).map_err(|error| of_interop(&error))?;
                Ok(Frame::on_device(loan, *ordinal, addresses, ranges))
            });
            Ok::<_, PyErr>((frames.collect::<PyResult<Vec<_>>>()?, statistics))
        });
        let (frames, statistics) = drawn?;
        self.keep(&statistics);
        Ok(frames)
    }
}

#[pymethods]
impl BatchRenderer {
    /// Draws each world for its cameras, as many as 32 cameras over one scene in one submission.
    ///
    /// Of each view an array [C, H, W, 4] of red, green, blue and alpha, rows from the top: uint8,
    /// or float32 as blended. The cameras of a view must be of one size.
    fn draw<'py>(
        &self,
        py: Python<'py>,
        views: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyList>> {
        let drawn = self.by_view(py, &copied(views)?)?;
        let array = |([cameras, rows, columns], layers): ([usize; 3], Layers)| {
            to_numpy(py, layers.color, &[cameras, rows, columns, 4])
        };
        PyList::new(
            py,
            drawn.into_iter().map(array).collect::<PyResult<Vec<_>>>()?,
        )
    }

    /// Draws like draw: ``color`` [C, H, W, 4], and where the session has them ``depth`` float32
    /// [C, H, W], meters along the camera's z, 0 where nothing was hit, ``instance`` int32 [C, H,
    /// W], 0 the background, and float32 planes of geometry: ``range`` [C, H, W], meters from the
    /// camera; ``normal`` [C, H, W, 3], world axes, towards the camera; ``flow_forward`` and
    /// ``flow_backward`` [C, H, W, 2], pixels; ``scene_flow`` [C, H, W, 3], m/s, world axes;
    /// ``depth_median`` and ``range_median`` [C, H, W], of the splat in which half of the light is
    /// gone.
    fn draw_layers<'py>(
        &self,
        py: Python<'py>,
        views: &Bound<'py, PyAny>,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let drawn = self.by_view(py, &copied(views)?)?;
        let dict = |(shape, layers): ([usize; 3], Layers)| {
            let dict = PyDict::new(py);
            let [cameras, rows, columns] = shape;
            dict.set_item(
                "color",
                to_numpy(py, layers.color, &[cameras, rows, columns, 4])?,
            )?;
            for (plane, values) in layers.planes {
                let channels = (plane.channels() > 1).then_some(plane.channels());
                let shape: Vec<usize> = shape.into_iter().chain(channels).collect();
                dict.set_item(plane.name(), to_numpy(py, values, &shape)?)?;
            }
            Ok(dict)
        };
        drawn.into_iter().map(dict).collect()
    }

    /// Draws like draw, and leaves the images in place: on the device if Session.exported,
    /// otherwise on the host.
    fn draw_dlpack(&self, py: Python<'_>, views: &Bound<'_, PyAny>) -> PyResult<Images> {
        let views = copied(views)?;
        let of_views = views.0.iter().map(|(_, cameras)| cameras.len()).collect();
        let frames = match &self.lender {
            Some(lender) => self.drawn_on_device(py, &views, lender)?,
            None => {
                let indices = views.indices();
                let sizes: Vec<_> = indices.iter().map(|index| views.size_px(*index)).collect();
                let layers = self.drawn(py, &views, &[indices])?;
                layers
                    .into_iter()
                    .map(|layers| Frame::on_host(layers, &sizes))
                    .collect()
            }
        };
        Ok(Images::new(frames, of_views))
    }

    /// Traces one sweep of a LiDAR through a world, on a vehicle that is at world_from_rig, float64
    /// [4, 4], meters, when the sweep ends. It and the agents go on with their motion during the
    /// sweep; velocity, m/s along the axes of the world, and turn, rad/s about those of the
    /// vehicle, are the vehicle's.
    ///
    /// Arrays of N returns: ``points`` float32 [N, 3], meters, in ``frame``: ``raw``, ``start`` or
    /// ``end`` of the sensor, ``ego`` (of the vehicle at the end) or ``world``; ``range`` and
    /// ``intensity`` (0 to 1) float32 [N]; ``offset_ns`` since the start of the sweep, ``column``
    /// and ``beam`` uint32 [N]; ``ring`` (from the highest), ``laser`` and ``instance`` (0 the
    /// background) uint16 [N]; ``return_number`` and ``return_count`` of the beam, uint8 [N]. NumPy
    /// arrays, which ``from_dlpack`` of other libraries takes as they are.
    #[pyo3(signature = (world, lidar, world_from_rig, *, velocity = [0.0; 3], turn = [0.0; 3], frame = "ego", returns = None, opacity_min = 0.5, seed = 0))]
    #[allow(clippy::too_many_arguments, reason = "they are keywords in Python")]
    fn sweep<'py>(
        &self,
        py: Python<'py>,
        world: &World,
        lidar: &Lidar,
        world_from_rig: &Bound<'py, PyAny>,
        velocity: [f64; 3],
        turn: [f64; 3],
        frame: &str,
        returns: Option<&str>,
        opacity_min: f32,
        seed: u64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let rig = &lidar.inner;
        let options = options_of(rig, returns, opacity_min, seed)?;
        let placed = rig.sweep_until(
            &pose_of("world_from_rig", world_from_rig)?,
            &motion_of((velocity, turn))?,
        );
        let world = world.lock().clone();
        let traced = py.detach(|| {
            let sweep_s = placed.model.sweep_s;
            let mut state = lock(&self.state);
            state.renderer.trace(&world, &placed, sweep_s, options.mode)
        });
        let sweep = traced
            .map_err(|error| of_session(&error))?
            .returns(&options);
        to_dict(py, &points_of(&sweep, frame)?)
    }

    /// Takes back images that nobody reads any more, which each draw_dlpack does first; how many
    /// frames the device still reads.
    fn collect(&self, py: Python<'_>) -> PyResult<usize> {
        let Some((lender, _)) = &self.lender else {
            return Ok(0);
        };
        py.detach(|| lender.collect())
            .map_err(|error| of_interop(&error))
    }

    /// Buffers of the renderer that are imported into CUDA.
    #[getter]
    fn imports(&self) -> usize {
        self.lender
            .as_ref()
            .map_or(0, |(lender, _)| lender.imports())
    }

    /// Statistics of the last call, one per frame.
    #[getter]
    fn statistics(&self) -> Vec<Statistics> {
        lock(&self.statistics).clone()
    }
}
