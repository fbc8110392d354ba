//! The window: keys, mouse and pixels around a [`Viewing`].
//!
//! What to do about a surface that gives no image is said in [`super::surface`]. A lost device ends the viewer, with a message.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use eyeline_visibility::Resolution;
use wgpu::CurrentSurfaceTexture as Current;
use winit::application::ApplicationHandler;
use winit::dpi::LogicalSize;
use winit::event::{DeviceEvent, DeviceId, ElementState, MouseButton, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::window::{CursorGrabMode, Window, WindowId};

use super::gpu::{self, AdapterChoice, Gpu, GpuError};
use super::inspect::Show;
use super::picture::Stage;
use super::player::Held;
use super::record::Recorder;
use super::renderer::Frame;
use super::surface::{Failures, Remedy, Said, drawable};
use super::viewing::Viewing;
use crate::app::{interrupted, print};

/// How the window begins.
#[derive(Clone, Debug)]
pub struct WindowOptions {
    /// Width and height in logical pixels.
    pub size: Resolution,
    /// Title.
    pub title: String,
    /// Which adapters will do.
    pub adapter: AdapterChoice,
    /// Where pictures go.
    pub pictures: PathBuf,
    /// End after so long.
    pub end_after: Option<Duration>,
    /// Where the way that was gone is written, as a camera path.
    pub record: Option<PathBuf>,
}

/// Radians a second by arrow keys, and a pixel of the mouse.
const TURN_BY_KEY: f64 = 1.6;
const TURN_BY_MOUSE: f64 = 0.0025;

/// Shows a world in a window until that is closed.
///
/// # Errors
/// If there is no screen or no adapter, or the device or the connection is lost.
pub fn run(viewing: Viewing, options: WindowOptions) -> anyhow::Result<()> {
    let events = EventLoop::new().map_err(|error| {
        // Its words name places in its source, which help nobody here.
        tracing::debug!("{error}");
        anyhow::anyhow!("no window can be opened: no X11 screen answers (DISPLAY); `shot` makes pictures without one")
    })?;
    events.set_control_flow(ControlFlow::Poll);
    let began = Instant::now();
    let recorder = options.record.is_some().then(Recorder::default);
    let mut app = App {
        viewing,
        options,
        interrupted: interrupted()?,
        live: None,
        held: Held::default(),
        turning: [[false; 2]; 2],
        is_grabbed: false,
        began,
        last: began,
        pictures: 0,
        wants_picture: false,
        recorder,
        failed: None,
    };
    events.run_app(&mut app)?;
    // Whatever ended it: the way was gone.
    if let (Some(recorder), Some(file)) = (&app.recorder, &app.options.record) {
        match recorder.write(file) {
            Ok(written) => print(&format!("{written}\n")),
            Err(error) => app.failed = app.failed.take().or(Some(error)),
        }
    }
    match app.failed.take() {
        Some(error) => Err(error),
        None => Ok(()),
    }
}

/// Pixels of a pixel of the font on a screen with so many physical pixels a logical one.
fn text_scale(scale_factor: f64) -> f32 {
    (scale_factor as f32 * 2.0).round().max(1.0)
}

/// What exists while there is a window.
struct Live {
    // Dropped first: it must not outlive the window.
    surface: wgpu::Surface<'static>,
    stage: Stage,
    gpu: Gpu,
    window: Arc<Window>,
    config: wgpu::SurfaceConfiguration,
    /// Whether the surface fits the window.
    is_configured: bool,
    is_covered: bool,
    failures: Failures,
}

struct App {
    viewing: Viewing,
    options: WindowOptions,
    interrupted: Arc<AtomicBool>,
    live: Option<Live>,
    held: Held,
    /// Arrow keys: left and right, up and down.
    turning: [[bool; 2]; 2],
    is_grabbed: bool,
    began: Instant,
    last: Instant,
    /// Pictures written so far.
    pictures: u32,
    wants_picture: bool,
    recorder: Option<Recorder>,
    failed: Option<anyhow::Error>,
}

impl Live {
    fn new(events: &ActiveEventLoop, viewing: &Viewing, options: &WindowOptions) -> anyhow::Result<Live> {
        let size = LogicalSize::new(options.size.width, options.size.height);
        let attributes = Window::default_attributes().with_title(&options.title).with_inner_size(size);
        let window = Arc::new(events.create_window(attributes)?);
        let instance = gpu::instance();
        let no_surface = |error: wgpu::CreateSurfaceError| GpuError::Surface(error.to_string());
        let surface = instance.create_surface(Arc::clone(&window)).map_err(no_surface)?;
        let gpu = Gpu::new(instance, options.adapter, Some(&surface))?;
        let can = surface.get_capabilities(&gpu.adapter);
        // Light is computed linearly; a format that does not encode it would look dark.
        let format = can.formats.iter().copied().find(wgpu::TextureFormat::is_srgb).or(can.formats.first().copied());
        let format = format.ok_or_else(|| GpuError::Surface("it offers no format".into()))?;
        let mut config = surface
            .get_default_config(&gpu.adapter, 1, 1)
            .ok_or_else(|| GpuError::Surface(format!("{} cannot present to it", gpu.name())))?;
        (config.format, config.present_mode) = (format, wgpu::PresentMode::AutoVsync);
        let stage = Stage::new(&gpu, viewing.model(), &viewing.bodies(), format)?;
        tracing::info!(adapter = %gpu.describe(), "drawing");
        Ok(Live {
            surface,
            stage,
            gpu,
            window,
            config,
            is_configured: false,
            is_covered: false,
            failures: Failures::default(),
        })
    }

    /// The size of the surface once it fits the window; `None` if there is nothing to draw on.
    fn fit(&mut self) -> Option<Resolution> {
        let size = self.window.inner_size();
        let most = self.gpu.device.limits().max_texture_dimension_2d;
        let Some(Resolution { width, height }) = drawable(size.width, size.height, most) else {
            self.is_configured = false;
            return None;
        };
        if !self.is_configured || (self.config.width, self.config.height) != (width, height) {
            (self.config.width, self.config.height) = (width, height);
            self.surface.configure(&self.gpu.device, &self.config);
            self.is_configured = true;
        }
        Some(Resolution::new(width, height))
    }

    /// The next image to draw on; `None` if there is none this time.
    fn acquire(&mut self) -> Result<Option<wgpu::SurfaceTexture>, GpuError> {
        let current = self.surface.get_current_texture();
        match self.failures.remedy(Said::of(&current)) {
            Remedy::None => {}
            Remedy::Fit => self.is_configured = false,
            Remedy::Wait { is_covered } => self.is_covered |= is_covered,
            Remedy::MakeAnew => {
                let made = self.gpu.instance.create_surface(Arc::clone(&self.window));
                self.surface = made.map_err(|error| GpuError::Surface(error.to_string()))?;
                self.is_configured = false;
            }
            Remedy::Ask => self.gpu.check()?,
            Remedy::End(why) => {
                // A device that is gone says more than its surfaces.
                self.gpu.check()?;
                return Err(GpuError::Surface(why.into()));
            }
        }
        if let Current::Success(texture) | Current::Suboptimal(texture) = current {
            return Ok(Some(texture));
        }
        Ok(None)
    }
}

impl App {
    fn redraw(&mut self) -> anyhow::Result<()> {
        let Some(live) = &mut self.live else { return Ok(()) };
        let now = Instant::now();
        let seconds = now.duration_since(self.last).as_secs_f64();
        self.last = now;
        let [left, right, up, down] = [self.turning[0][0], self.turning[0][1], self.turning[1][0], self.turning[1][1]]
            .map(|is_held| f64::from(u8::from(is_held)));
        let turn = TURN_BY_KEY * seconds.min(0.25);
        self.viewing.player.turn((left - right) * turn, (up - down) * turn);
        live.gpu.check()?;
        let Some(resolution) = live.fit() else {
            // Minimised: the world goes on, with nobody to draw for.
            std::thread::sleep(Duration::from_millis(50));
            return Ok(());
        };
        let Some(image) = live.acquire()? else {
            std::thread::sleep(Duration::from_millis(10));
            return Ok(());
        };
        let scale = text_scale(live.window.scale_factor());
        let clocked = |work: &mut dyn FnMut()| {
            let began = Instant::now();
            work();
            began.elapsed()
        };
        let composed = self.viewing.frame(self.held, seconds, resolution, scale, clocked);
        if let Some(recorder) = &mut self.recorder {
            let player = &self.viewing.player;
            let anchor = self.viewing.model().scene.anchor();
            recorder.add(&composed.view, anchor, [player.yaw, player.pitch], seconds);
        }
        live.stage.renderer.bones = composed.bones;
        live.stage.renderer.shade = composed.shade;
        let frame = Frame { view: composed.view, visible: &composed.visible, moving: &composed.moving };
        let view = image.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let began = Instant::now();
        live.stage.draw(&live.gpu, &view, &frame, &composed.overlay)?;
        self.viewing.drew(began.elapsed());
        live.window.pre_present_notify();
        live.gpu.queue.present(image);
        if std::mem::take(&mut self.wants_picture) {
            let (picture, _) = live.stage.picture(&live.gpu, &frame, &composed.overlay)?;
            let path = self.options.pictures.join(format!("eyeline-{}.png", self.pictures));
            self.pictures += 1;
            match picture.save(&path) {
                Ok(()) => print(&format!("{}\n", path.display())),
                Err(error) => tracing::error!("cannot write {}: {error}", path.display()),
            }
        }
        Ok(())
    }

    fn key(&mut self, events: &ActiveEventLoop, code: KeyCode, is_down: bool, is_repeat: bool) {
        match code {
            KeyCode::KeyW => self.held.along[0] = is_down,
            KeyCode::KeyS => self.held.along[1] = is_down,
            KeyCode::KeyD => self.held.across[0] = is_down,
            KeyCode::KeyA => self.held.across[1] = is_down,
            KeyCode::Space => self.held.upright[0] = is_down,
            KeyCode::KeyC => self.held.upright[1] = is_down,
            KeyCode::ShiftLeft | KeyCode::ShiftRight => self.held.fast = is_down,
            KeyCode::ArrowLeft => self.turning[0][0] = is_down,
            KeyCode::ArrowRight => self.turning[0][1] = is_down,
            KeyCode::ArrowUp => self.turning[1][0] = is_down,
            KeyCode::ArrowDown => self.turning[1][1] = is_down,
            // Those that step may be held.
            KeyCode::KeyN if is_down => {
                self.viewing.stop.cells = self.viewing.stop.cells.checked_add(1).unwrap_or(1);
            }
            KeyCode::KeyB if is_down => self.viewing.stop.cells = self.viewing.stop.cells.saturating_sub(1),
            KeyCode::KeyV if is_down => self.viewing.stop.cells = usize::MAX,
            _ if !is_down || is_repeat => {}
            KeyCode::Escape if self.is_grabbed => self.grab(false),
            KeyCode::Escape => events.exit(),
            KeyCode::KeyF => self.viewing.player.is_flying ^= true,
            KeyCode::KeyR => {
                if let Some(resolution) = self.live.as_mut().and_then(Live::fit) {
                    self.viewing.freeze(resolution);
                    // One looks from outside: walls are no hindrance.
                    self.viewing.player.is_flying = self.viewing.is_frozen();
                }
            }
            KeyCode::KeyP => self.wants_picture = true,
            _ => {
                const DIGITS: [KeyCode; 11] = [
                    KeyCode::Digit1,
                    KeyCode::Digit2,
                    KeyCode::Digit3,
                    KeyCode::Digit4,
                    KeyCode::Digit5,
                    KeyCode::Digit6,
                    KeyCode::Digit7,
                    KeyCode::Digit8,
                    KeyCode::Digit9,
                    KeyCode::Digit0,
                    KeyCode::Minus,
                ];
                if let Some((_, show)) = DIGITS.into_iter().zip(Show::ALL).find(|(digit, _)| *digit == code)
                    && !self.viewing.shows.remove(&show)
                {
                    self.viewing.shows.insert(show);
                }
            }
        }
    }

    /// Takes the mouse, or gives it back.
    fn grab(&mut self, takes: bool) {
        let Some(live) = &self.live else { return };
        if takes {
            // Not every system has both ways.
            let modes = [CursorGrabMode::Locked, CursorGrabMode::Confined];
            self.is_grabbed = modes.into_iter().any(|mode| live.window.set_cursor_grab(mode).is_ok());
        } else {
            let _ = live.window.set_cursor_grab(CursorGrabMode::None);
            self.is_grabbed = false;
        }
        live.window.set_cursor_visible(!self.is_grabbed);
    }

    fn fail(&mut self, events: &ActiveEventLoop, error: anyhow::Error) {
        self.failed = Some(error);
        self.live = None;
        events.exit();
    }
}

impl ApplicationHandler for App {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.live.is_some() {
            return;
        }
        match Live::new(events, &self.viewing, &self.options) {
            Ok(live) => {
                live.window.request_redraw();
                self.live = Some(live);
                self.last = Instant::now();
                // Whoever scripts a session waits for this line.
                print("the window is open\n");
            }
            Err(error) => self.fail(events, error),
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested => events.exit(),
            WindowEvent::KeyboardInput { event, .. } => {
                if let PhysicalKey::Code(code) = event.physical_key {
                    self.key(events, code, event.state == ElementState::Pressed, event.repeat);
                }
            }
            WindowEvent::MouseInput { state: ElementState::Pressed, button: MouseButton::Left, .. } => self.grab(true),
            WindowEvent::Focused(false) => {
                // Keys that come up elsewhere are never heard of.
                (self.held, self.turning) = (Held::default(), [[false; 2]; 2]);
                self.grab(false);
            }
            WindowEvent::Occluded(is_covered) => {
                if let Some(live) = &mut self.live {
                    live.is_covered = is_covered;
                }
            }
            WindowEvent::RedrawRequested => {
                if let Err(error) = self.redraw() {
                    self.fail(events, error);
                }
            }
            _ => {}
        }
    }

    fn device_event(&mut self, _: &ActiveEventLoop, _: DeviceId, event: DeviceEvent) {
        if let DeviceEvent::MouseMotion { delta: (x, y) } = event
            && self.is_grabbed
        {
            self.viewing.player.turn(-x * TURN_BY_MOUSE, -y * TURN_BY_MOUSE);
        }
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        if let Some(reason) = self.viewing.ended() {
            let error = anyhow::anyhow!("{reason}");
            self.fail(events, error);
            return;
        }
        let is_over = self.options.end_after.is_some_and(|after| self.began.elapsed() >= after);
        if is_over || self.interrupted.load(Ordering::Relaxed) {
            events.exit();
            return;
        }
        if let Some(live) = &self.live {
            if live.is_covered {
                std::thread::sleep(Duration::from_millis(50));
            }
            live.window.request_redraw();
        }
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        // Before the event loop, whose display the surface draws on.
        self.live = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_grow_with_the_screens_pixels() {
        assert_eq!([0.1, 1.0, 1.25, 1.5, 2.0, 3.0].map(text_scale), [1.0, 2.0, 3.0, 3.0, 4.0, 6.0]);
    }
}
