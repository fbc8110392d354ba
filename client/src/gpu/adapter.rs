//! Which graphics adapter draws, and what becomes of its errors?
//!
//! A real GPU is preferred, then Vulkan in software, which is slow and exact. Without either there is one line that says what to
//! install. wgpu tells of lost devices and of errors by callbacks; they are kept here until the next [`Gpu::check`], so that a
//! viewer ends with a message and not in the middle of a driver.

use std::sync::{Arc, Mutex, PoisonError};

use eyeline_visibility::Resolution;

/// Why nothing can be drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// There is no adapter at all.
    #[error(
        "no graphics adapter with Vulkan was found; install a driver for the GPU, or one in software \
         (on Debian: apt install mesa-vulkan-drivers)"
    )]
    NoAdapter,
    /// There are adapters, but none that was asked for.
    #[error("no {wanted} adapter was found, only {found}")]
    NoneOfKind {
        /// What was asked for.
        wanted: &'static str,
        /// Which there are.
        found: String,
    },
    /// The adapter gives no device.
    #[error("{adapter} cannot be used: {source}")]
    NoDevice {
        /// Name of the adapter.
        adapter: String,
        /// Why.
        source: wgpu::RequestDeviceError,
    },
    /// No surface for the window.
    #[error("cannot draw into the window: {0}")]
    Surface(String),
    /// The device is gone: a driver crashed, was updated, or the card was taken out.
    #[error("{adapter} was lost ({reason}); start the viewer again")]
    Lost {
        /// Name of the adapter.
        adapter: String,
        /// What the driver says.
        reason: String,
    },
    /// The adapter's memory is full.
    #[error("{adapter} has no memory left for {what}; take a smaller scene or window")]
    OutOfMemory {
        /// Name of the adapter.
        adapter: String,
        /// What was to be stored.
        what: String,
    },
    /// Something is larger than the adapter takes.
    #[error("{what} of {size} is more than {adapter} takes ({limit}); {remedy}")]
    TooLarge {
        /// What.
        what: String,
        /// How large it is, with its unit.
        size: String,
        /// Name of the adapter.
        adapter: String,
        /// How large it may be, with its unit.
        limit: String,
        /// What can be done.
        remedy: &'static str,
    },
    /// The adapter cannot do something at all.
    #[error("{adapter} has no {what}")]
    Lacks {
        /// Name of the adapter.
        adapter: String,
        /// What it would need.
        what: &'static str,
    },
    /// The driver refused a command, which is our mistake or its own.
    #[error("{adapter} refused a command: {reason}")]
    Refused {
        /// Name of the adapter.
        adapter: String,
        /// Its words.
        reason: String,
    },
}

/// Which adapters will do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AdapterChoice {
    /// A real GPU if there is one, else software.
    #[default]
    Best,
    /// Software only: the same picture on every machine.
    Software,
}

/// What went wrong since the last look.
#[derive(Debug)]
enum Fault {
    OutOfMemory(String),
    Refused(String),
}

impl From<wgpu::Error> for Fault {
    fn from(error: wgpu::Error) -> Fault {
        match error {
            wgpu::Error::OutOfMemory { source } => Fault::OutOfMemory(source.to_string()),
            other => Fault::Refused(other.to_string()),
        }
    }
}

/// Shared with the driver's callbacks.
#[derive(Debug, Default)]
struct Faults {
    first: Mutex<Option<Fault>>,
    /// Why the device is gone, if it is: for good, so that it is told again and again.
    lost: Mutex<Option<String>>,
}

impl Faults {
    fn lost(&self) -> Option<String> {
        self.lost.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// An adapter and a device of it.
#[derive(Debug)]
pub struct Gpu {
    /// The way in, for surfaces.
    pub instance: wgpu::Instance,
    /// The adapter.
    pub adapter: wgpu::Adapter,
    /// Makes buffers, textures and pipelines.
    pub device: wgpu::Device,
    /// Takes commands.
    pub queue: wgpu::Queue,
    name: String,
    faults: Arc<Faults>,
}

/// An instance that knows Vulkan.
pub fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN;
    wgpu::Instance::new(descriptor)
}

impl Gpu {
    /// A device to draw pictures with, without a window.
    ///
    /// # Errors
    /// If there is no adapter of the kind, or it gives no device.
    pub fn offscreen(choice: AdapterChoice) -> Result<Gpu, GpuError> {
        Gpu::new(instance(), choice, None)
    }

    /// The same with less than the adapter has: `lower` makes its limits smaller, as those of a smaller card would be.
    ///
    /// # Errors
    /// As [`Gpu::offscreen`].
    pub fn offscreen_within(choice: AdapterChoice, lower: impl FnOnce(&mut wgpu::Limits)) -> Result<Gpu, GpuError> {
        Gpu::open(instance(), choice, None, lower)
    }

    /// A device that can draw into a surface of this instance, if one is given.
    ///
    /// # Errors
    /// As [`Gpu::offscreen`].
    pub fn new(
        instance: wgpu::Instance,
        choice: AdapterChoice,
        surface: Option<&wgpu::Surface<'_>>,
    ) -> Result<Gpu, GpuError> {
        Gpu::open(instance, choice, surface, |_| {})
    }

    fn open(
        instance: wgpu::Instance,
        choice: AdapterChoice,
        surface: Option<&wgpu::Surface<'_>>,
        lower: impl FnOnce(&mut wgpu::Limits),
    ) -> Result<Gpu, GpuError> {
        let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
        if adapters.is_empty() {
            return Err(GpuError::NoAdapter);
        }
        let found = || adapters.iter().map(|adapter| adapter.get_info().name).collect::<Vec<_>>().join(", ");
        let is_fit = |adapter: &wgpu::Adapter| {
            let is_of_kind = choice == AdapterChoice::Best || is_software(adapter);
            is_of_kind && surface.is_none_or(|surface| adapter.is_surface_supported(surface))
        };
        let best = (adapters.iter().enumerate())
            .filter(|(_, adapter)| is_fit(adapter))
            .min_by_key(|(_, adapter)| rank(adapter));
        let Some((best, _)) = best else {
            let wanted = match (choice, surface) {
                (AdapterChoice::Software, _) => "software",
                (AdapterChoice::Best, _) => "suitable",
            };
            return Err(GpuError::NoneOfKind { wanted, found: found() });
        };
        let adapter = adapters.swap_remove(best);
        let name = adapter.get_info().name;
        // All that the adapter has: whether a scene fits is asked when it is loaded.
        let mut required_limits = adapter.limits();
        lower(&mut required_limits);
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("viewer"),
            // Counting fragments that pass wants the depth test before the shader; whoever needs it asks whether it is there.
            required_features: adapter.features() & wgpu::Features::SHADER_EARLY_DEPTH_TEST,
            required_limits,
            ..wgpu::DeviceDescriptor::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|source| GpuError::NoDevice { adapter: name.clone(), source })?;
        let faults = Arc::<Faults>::default();
        let lost = Arc::clone(&faults);
        // It is also called when the device is dropped, when nobody asks any more.
        device.set_device_lost_callback(move |_, message| {
            let mut lost = lost.lost.lock().unwrap_or_else(PoisonError::into_inner);
            lost.get_or_insert(message);
        });
        let refused = Arc::clone(&faults);
        device.on_uncaptured_error(Arc::new(move |error| {
            keep(&refused, Fault::from(error));
        }));
        Ok(Gpu { instance, adapter, device, queue, name, faults })
    }

    /// Name of the adapter and of its driver, for people.
    pub fn describe(&self) -> String {
        let wgpu::AdapterInfo { name, driver, driver_info, .. } = self.adapter.get_info();
        format!("{name} ({driver} {driver_info})")
    }

    /// Name of the adapter.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether a processor does the drawing.
    pub fn is_software(&self) -> bool {
        is_software(&self.adapter)
    }

    /// Whether all is well.
    ///
    /// # Errors
    /// What the driver said went wrong since the last call. After [`GpuError::Lost`] nothing works any more, and each call says so.
    pub fn check(&self) -> Result<(), GpuError> {
        let fault = self.faults.first.lock().unwrap_or_else(PoisonError::into_inner).take();
        if fault.is_some() && self.faults.lost().is_none() {
            // A loss is told by a callback of its own, which the next poll makes, and says more than what it leads to.
            let _ = self.device.poll(wgpu::PollType::Poll);
        }
        verdict(&self.name, self.faults.lost(), fault)
    }

    /// What an error that a call returned, and no callback told, comes to: a loss, if that is behind it.
    pub(crate) fn diagnose(&self, reason: String) -> GpuError {
        let _ = self.device.poll(wgpu::PollType::Poll);
        self.check().err().unwrap_or(GpuError::Refused { adapter: self.name.clone(), reason })
    }

    /// A buffer with these bytes in it.
    ///
    /// # Errors
    /// If it is larger than the adapter takes.
    pub fn buffer(&self, what: &str, usage: wgpu::BufferUsages, bytes: &[u8]) -> Result<wgpu::Buffer, GpuError> {
        let buffer = self.empty_buffer(what, usage | wgpu::BufferUsages::COPY_DST, bytes.len() as u64)?;
        self.queue.write_buffer(&buffer, 0, bytes);
        Ok(buffer)
    }

    /// A buffer for so many bytes; at least a few, since a buffer without any can't be bound.
    ///
    /// # Errors
    /// If it is larger than the adapter takes.
    pub fn empty_buffer(&self, what: &str, usage: wgpu::BufferUsages, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
        self.check_buffer(what, usage, bytes)?;
        let size = bytes.max(16).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT);
        let descriptor = wgpu::BufferDescriptor { label: Some(what), size, usage, mapped_at_creation: false };
        Ok(self.device.create_buffer(&descriptor))
    }

    /// Whether a buffer for this use may be so large.
    ///
    /// # Errors
    /// If not.
    pub fn check_buffer(&self, what: &str, usage: wgpu::BufferUsages, bytes: u64) -> Result<(), GpuError> {
        let (name, limit) = self.buffer_limit(usage);
        if bytes <= limit {
            return Ok(());
        }
        Err(GpuError::TooLarge {
            what: what.into(),
            size: amount(bytes),
            adapter: self.name.clone(),
            limit: format!("{name} is {}", amount(limit)),
            remedy: "take a smaller scene or another adapter",
        })
    }

    /// The limit that a buffer for this use meets first, and how many bytes it allows. Shaders are given buffers whole.
    pub(super) fn buffer_limit(&self, usage: wgpu::BufferUsages) -> (&'static str, u64) {
        let limits = self.device.limits();
        let whole = ("max_buffer_size", limits.max_buffer_size);
        let storage = ("max_storage_buffer_binding_size", limits.max_storage_buffer_binding_size);
        let uniform = ("max_uniform_buffer_binding_size", limits.max_uniform_buffer_binding_size);
        let is_met = |of| usage.contains(of);
        let bound = [(is_met(wgpu::BufferUsages::STORAGE), storage), (is_met(wgpu::BufferUsages::UNIFORM), uniform)];
        let met = bound.into_iter().filter(|(is_met, _)| *is_met).map(|(_, limit)| limit);
        met.fold(whole, |least, limit| if limit.1 < least.1 { limit } else { least })
    }

    /// A texture of an image's size, without mipmaps.
    ///
    /// # Errors
    /// If the adapter takes no image of that size.
    pub fn texture(
        &self,
        what: &str,
        resolution: Resolution,
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
    ) -> Result<wgpu::Texture, GpuError> {
        let Resolution { width, height } = resolution;
        let limit = self.device.limits().max_texture_dimension_2d;
        if width.max(height) > limit {
            return Err(GpuError::TooLarge {
                what: format!("an image ({what})"),
                size: format!("{width}x{height} pixels"),
                adapter: self.name.clone(),
                limit: format!("max_texture_dimension_2d is {limit} a side"),
                remedy: "take a smaller one",
            });
        }
        Ok(self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(what),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        }))
    }
}

/// Bytes for people: small limits would all be 0 MiB.
fn amount(bytes: u64) -> String {
    if bytes < 10 << 20 { format!("{bytes} bytes") } else { format!("{} MiB", bytes >> 20) }
}

/// What people are told: a loss says more than what it leads to.
fn verdict(adapter: &str, lost: Option<String>, fault: Option<Fault>) -> Result<(), GpuError> {
    let adapter = adapter.to_owned();
    match (lost, fault) {
        (Some(reason), _) => Err(GpuError::Lost { adapter, reason }),
        (None, Some(Fault::OutOfMemory(what))) => Err(GpuError::OutOfMemory { adapter, what }),
        (None, Some(Fault::Refused(reason))) => Err(GpuError::Refused { adapter, reason }),
        (None, None) => Ok(()),
    }
}

fn keep(faults: &Faults, fault: Fault) {
    // The first says most; what follows are its consequences.
    faults.first.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(fault);
}

fn is_software(adapter: &wgpu::Adapter) -> bool {
    adapter.get_info().device_type == wgpu::DeviceType::Cpu
}

/// The lower, the better.
fn rank(adapter: &wgpu::Adapter) -> u32 {
    match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loss_comes_before_what_it_leads_to_and_full_memory_has_a_remedy() {
        let full = || Fault::from(wgpu::Error::OutOfMemory { source: "buffer 'triangles'".into() });
        assert!(verdict("a card", None, None).is_ok());
        let lost = verdict("a card", Some("it was taken out".into()), Some(full())).unwrap_err();
        assert!(
            matches!(&lost, GpuError::Lost { adapter, reason } if adapter == "a card" && reason == "it was taken out")
        );
        let error = verdict("a card", None, Some(full())).unwrap_err();
        assert!(matches!(error, GpuError::OutOfMemory { .. }), "{error:?}");
        let text = error.to_string();
        assert!(["a card", "triangles", "smaller scene or window"].iter().all(|word| text.contains(word)), "{text}");
        let other = wgpu::Error::Validation { source: "x".into(), description: "no such layout".into() };
        let refused = verdict("a card", None, Some(other.into())).unwrap_err();
        assert!(
            matches!(&refused, GpuError::Refused { reason, .. } if reason.contains("no such layout")),
            "{refused:?}"
        );
    }

    #[test]
    fn the_first_fault_is_kept_and_a_loss_for_good() {
        let faults = Faults::default();
        keep(&faults, Fault::Refused("first".into()));
        keep(&faults, Fault::OutOfMemory("second".into()));
        let first = faults.first.lock().unwrap().take();
        assert!(matches!(first, Some(Fault::Refused(reason)) if reason == "first"));
        *faults.lost.lock().unwrap() = Some("gone".into());
        assert_eq!([faults.lost(), faults.lost()], [Some("gone".to_owned()), Some("gone".to_owned())]);
    }

    #[test]
    fn small_amounts_are_told_to_the_byte() {
        assert_eq!(amount(0), "0 bytes");
        assert_eq!(amount(288_000), "288000 bytes");
        assert_eq!(amount(256 << 20), "256 MiB");
    }
}
