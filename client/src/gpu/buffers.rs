//! Buffers that outlive a frame: those that grow with what is written, and those that are read back.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use super::{Gpu, GpuError};

/// A buffer that is made larger when it has to be.
#[derive(Debug)]
pub(super) struct Growing {
    label: &'static str,
    usage: wgpu::BufferUsages,
    buffer: Option<wgpu::Buffer>,
}

impl Growing {
    pub(super) fn new(label: &'static str, usage: wgpu::BufferUsages) -> Growing {
        Growing { label, usage: usage | wgpu::BufferUsages::COPY_DST, buffer: None }
    }

    /// Makes room for so many bytes; whether the buffer is a new one, with nothing in it.
    pub(super) fn reserve(&mut self, gpu: &Gpu, bytes: u64) -> Result<bool, GpuError> {
        if self.buffer.as_ref().is_some_and(|buffer| buffer.size() >= bytes) {
            return Ok(false);
        }
        // By half more, lest what grows slowly be allocated anew each time; but the limit is on what is needed.
        gpu.check_buffer(self.label, self.usage, bytes)?;
        let limit = gpu.buffer_limit(self.usage).1 & !15;
        let roomy = (bytes * 3 / 2).clamp(1 << 12, limit.max(bytes));
        self.buffer = Some(gpu.empty_buffer(self.label, self.usage, roomy)?);
        Ok(true)
    }

    pub(super) fn write(&mut self, gpu: &Gpu, bytes: &[u8]) -> Result<&wgpu::Buffer, GpuError> {
        self.reserve(gpu, bytes.len() as u64)?;
        gpu.queue.write_buffer(self.get(), 0, bytes);
        Ok(self.get())
    }

    /// The buffer, once there was a reason for one.
    pub(super) fn get(&self) -> &wgpu::Buffer {
        self.buffer.as_ref().expect("reserved before it is used")
    }
}

/// A buffer that is read back, one copy at a time.
#[derive(Debug, Default)]
pub(super) struct ReadBack {
    buffer: Option<wgpu::Buffer>,
    /// Of the copy under way: [`WAITING`], [`HERE`] or [`FAILED`].
    state: Arc<AtomicU8>,
    is_under_way: bool,
    bytes: u64,
}

const WAITING: u8 = 0;
const HERE: u8 = 1;
const FAILED: u8 = 2;

impl ReadBack {
    /// The buffer to copy so many bytes into.
    pub(super) fn prepare(&mut self, gpu: &Gpu, bytes: u64) -> Result<&wgpu::Buffer, GpuError> {
        // What was abandoned under way may still be written and mapped: it gets lost.
        let fits = self.buffer.take().filter(|buffer| !self.is_under_way && buffer.size() >= bytes.next_multiple_of(8));
        self.is_under_way = false;
        self.bytes = bytes;
        let buffer = match fits {
            Some(buffer) => buffer,
            None => {
                let usage = wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ;
                gpu.empty_buffer("read back", usage, bytes.next_multiple_of(8))?
            }
        };
        Ok(self.buffer.insert(buffer))
    }

    /// Asks for what was copied, after the copy was submitted.
    pub(super) fn request(&mut self) {
        let Some(buffer) = &self.buffer else { return };
        self.state = Arc::new(AtomicU8::new(WAITING));
        self.is_under_way = true;
        let state = Arc::clone(&self.state);
        buffer.slice(..self.bytes.next_multiple_of(8)).map_async(wgpu::MapMode::Read, move |mapped| {
            state.store(if mapped.is_ok() { HERE } else { FAILED }, Ordering::Release);
        });
    }

    /// Calls `read` with the bytes if they are here; `None` if they are not yet.
    ///
    /// # Errors
    /// If they never will be.
    pub(super) fn read<T>(&mut self, gpu: &Gpu, read: impl FnOnce(&[u8]) -> T) -> Result<Option<T>, GpuError> {
        let refused = |reason: String| gpu.diagnose(reason);
        let (true, Some(buffer)) = (self.is_under_way, &self.buffer) else {
            return Err(refused("nothing was asked to be read back".into()));
        };
        match self.state.load(Ordering::Acquire) {
            WAITING => return Ok(None),
            HERE => {}
            _ => {
                self.buffer = None;
                self.is_under_way = false;
                return Err(refused("what was drawn could not be read back".into()));
            }
        }
        let range = buffer.slice(..self.bytes.next_multiple_of(8)).get_mapped_range();
        let range = range.map_err(|error| refused(error.to_string()))?;
        let value = read(&range[..self.bytes as usize]);
        drop(range);
        buffer.unmap();
        self.is_under_way = false;
        Ok(Some(value))
    }
}

/// Waits for what was submitted, at most so long.
///
/// # Errors
/// What the driver says. That it took longer is no error.
pub(super) fn wait(
    gpu: &Gpu,
    submission: &wgpu::SubmissionIndex,
    timeout: Option<std::time::Duration>,
) -> Result<(), GpuError> {
    let poll = wgpu::PollType::Wait { submission_index: Some(submission.clone()), timeout };
    let polled = gpu.device.poll(poll);
    gpu.check()?;
    match polled {
        Ok(_) | Err(wgpu::PollError::Timeout) => Ok(()),
        Err(error) => Err(gpu.diagnose(error.to_string())),
    }
}

impl Gpu {
    /// The texels of a texture of four bytes a texel, row by row from the top and without gaps. Waits for them.
    ///
    /// # Errors
    /// If the adapter takes no buffer of that size, or what its driver says.
    pub fn read_texture(&self, texture: &wgpu::Texture) -> Result<Vec<u8>, GpuError> {
        let bytes_per_texel = texture.format().block_copy_size(None);
        debug_assert_eq!(bytes_per_texel, Some(4), "{:?}", texture.format());
        let used = 4 * texture.width();
        let row = used.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let mut read_back = ReadBack::default();
        let buffer = read_back.prepare(self, u64::from(row) * u64::from(texture.height()))?;
        let label = Some("read back");
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label });
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
        let to = wgpu::TexelCopyBufferInfo { buffer, layout };
        encoder.copy_texture_to_buffer(texture.as_image_copy(), to, texture.size());
        let submission = self.queue.submit([encoder.finish()]);
        read_back.request();
        wait(self, &submission, None)?;
        let texels = read_back.read(self, |bytes| {
            bytes.chunks_exact(row as usize).flat_map(|row| &row[..used as usize]).copied().collect()
        })?;
        texels.ok_or_else(|| GpuError::Refused {
            adapter: self.name().to_owned(),
            reason: "a finished picture could not be read back".into(),
        })
    }
}
