//! Which graphics adapter draws, and what becomes of its errors?
//!
//! A real GPU is preferred, then Vulkan in software, which is slow and exact. Without either there is one line that says what to
//! install. wgpu tells of lost devices and of errors by callbacks; they are kept here until the next [`Gpu::check`], so that a
//! viewer ends with a message and not in the middle of a driver.

use std::sync::{Arc, Mutex, PoisonError};

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
    Lost(String),
    OutOfMemory(String),
    Refused(String),
}

type Faults = Arc<Mutex<Option<Fault>>>;

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
    faults: Faults,
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

    /// A device that can draw into a surface of this instance, if one is given.
    ///
    /// # Errors
    /// As [`Gpu::offscreen`].
    pub fn new(
        instance: wgpu::Instance,
        choice: AdapterChoice,
        surface: Option<&wgpu::Surface<'_>>,
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
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("viewer"),
            required_limits: adapter.limits(),
            ..wgpu::DeviceDescriptor::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|source| GpuError::NoDevice { adapter: name.clone(), source })?;
        let faults = Faults::default();
        let lost = Arc::clone(&faults);
        // It is also called when the device is dropped, and then nobody asks any more.
        device.set_device_lost_callback(move |_, message| keep(&lost, Fault::Lost(message)));
        let refused = Arc::clone(&faults);
        device.on_uncaptured_error(Arc::new(move |error| {
            let fault = match error {
                wgpu::Error::OutOfMemory { source } => Fault::OutOfMemory(source.to_string()),
                other => Fault::Refused(other.to_string()),
            };
            keep(&refused, fault);
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
    /// What the driver said went wrong since the last call. After [`GpuError::Lost`] nothing works any more.
    pub fn check(&self) -> Result<(), GpuError> {
        let take = || self.faults.lock().unwrap_or_else(PoisonError::into_inner).take();
        let mut fault = take();
        if matches!(fault, Some(Fault::Refused(_))) {
            // A lost device refuses everything, and says that it is lost only when it is polled.
            let _ = self.device.poll(wgpu::PollType::Poll);
            fault = match take() {
                Some(lost @ Fault::Lost(_)) => Some(lost),
                _ => fault,
            };
        }
        let adapter = self.name.clone();
        match fault {
            None => Ok(()),
            Some(Fault::Lost(reason)) => Err(GpuError::Lost { adapter, reason }),
            Some(Fault::OutOfMemory(what)) => Err(GpuError::OutOfMemory { adapter, what }),
            Some(Fault::Refused(reason)) => Err(GpuError::Refused { adapter, reason }),
        }
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
        let limit = self.device.limits().max_buffer_size;
        if bytes > limit {
            return Err(GpuError::TooLarge {
                what: what.into(),
                size: format!("{} MiB", bytes >> 20),
                adapter: self.name.clone(),
                limit: format!("{} MiB", limit >> 20),
                remedy: "take a smaller scene",
            });
        }
        let size = bytes.max(16).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT);
        let descriptor = wgpu::BufferDescriptor { label: Some(what), size, usage, mapped_at_creation: false };
        Ok(self.device.create_buffer(&descriptor))
    }
}

fn keep(faults: &Faults, fault: Fault) {
    let mut kept = faults.lock().unwrap_or_else(PoisonError::into_inner);
    // The first says most; what follows are its consequences. But a loss is final.
    if kept.is_none() || matches!(fault, Fault::Lost(_)) {
        *kept = Some(fault);
    }
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
