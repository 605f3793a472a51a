//! The open device, as the rest of the engine sees it.

use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytemuck::Pod;

use crate::{
    Buffer, DeviceChoice, DeviceInfo, DeviceOptions, DeviceSet, GpuError, Kernel, KernelCounts,
    KernelReport, Limits, MemoryKind, MemoryReport, QueueRole, Recorder, Shader, Ticket, Uploads,
    choice, context::Context, device, drill::DrillState, instance::Instance, kernel::Kernels,
    memory::BufferMemory, queue::Queue, transfer,
};

/// One moment on the clocks of host and device.
#[derive(Clone, Copy, Debug)]
pub struct DeviceClock {
    /// Time on the host's clock.
    pub host: Instant,
    /// Time on the device's clock, nanoseconds.
    pub device_ns: u64,
    /// Largest difference between the two.
    pub uncertainty: Duration,
}

/// An open device. Clones share it; dropping the last one waits until the device is idle.
#[derive(Clone)]
pub struct Gpu(Arc<Shared>);

struct Shared {
    main: Arc<Queue>,
    /// Queue beside `main`; `main` itself where the device has none.
    update: Arc<Queue>,
    kernels: Kernels,
    context: Arc<Context>,
}

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.info())
    }
}

impl Gpu {
    /// All devices that the loader finds, whether they can do the work or not.
    ///
    /// # Errors
    /// Returns an error if there is no loader or no device; the sentence says what to install.
    pub fn list() -> Result<Vec<DeviceInfo>, GpuError> {
        let devices = device::enumerate(&Instance::new(false)?)?;
        if devices.is_empty() {
            return Err(GpuError::NoDevice);
        }
        Ok(devices.into_iter().map(|device| device.info).collect())
    }

    /// Opens a device.
    ///
    /// # Errors
    /// Returns an error if there is no loader, no validation layer where one is asked for, no such
    /// device, or the device lacks what we require: Vulkan 1.3 with timeline semaphores, host query
    /// reset, scalar block layout, synchronization2 and maintenance4, and `VK_KHR_push_descriptor`.
    pub fn open(options: &DeviceOptions) -> Result<Self, GpuError> {
        let context = Arc::new(Context::open(options)?);
        let families = context.families;
        let main = Arc::new(Queue::new(
            &context,
            families.main,
            families.main_timestamp_bits,
        )?);
        let update = match families.update {
            Some(family) => Arc::new(Queue::new(
                &context,
                family,
                families.update_timestamp_bits,
            )?),
            None => main.clone(),
        };
        Ok(Self(Arc::new(Shared {
            main,
            update,
            kernels: Kernels::default(),
            context,
        })))
    }

    /// Opens each of `devices`, by the options that `options` gives for its position but for their
    /// choice. A device that lacks something is left out of [`DeviceSet::All`] if there is another.
    ///
    /// # Errors
    /// Returns the errors of [`Gpu::open`].
    pub fn open_all(
        devices: &DeviceSet,
        options: impl Fn(usize) -> DeviceOptions,
    ) -> Result<Vec<Self>, GpuError> {
        let open = |(position, choice): (usize, DeviceChoice)| {
            Self::open(&DeviceOptions {
                choice,
                ..options(position)
            })
        };
        let uuids = match devices {
            DeviceSet::Each(choices) => {
                return choices.iter().cloned().enumerate().map(open).collect();
            }
            DeviceSet::All => choice::all_of(&Self::list()?),
        };
        let (mut opened, mut refusal) = (Vec::new(), GpuError::NoDevice);
        for uuid in uuids {
            match open((opened.len(), DeviceChoice::Uuid(uuid))) {
                Ok(gpu) => opened.push(gpu),
                Err(error @ GpuError::MissingFeature { .. }) => refusal = error,
                Err(error) => return Err(error),
            }
        }
        if opened.is_empty() {
            return Err(refusal);
        }
        Ok(opened)
    }

    /// The device.
    #[must_use]
    pub fn info(&self) -> &DeviceInfo {
        &self.0.context.info
    }

    /// Limits of the device.
    #[must_use]
    pub fn limits(&self) -> &Limits {
        &self.0.context.limits
    }

    /// Kernels that were built, and how many of them the driver found among those kept
    /// ([`DeviceOptions::kernels`]).
    #[must_use]
    pub fn kernel_counts(&self) -> KernelCounts {
        self.0.context.pipelines.counts()
    }

    /// Registers and shared memory of the kernels that were built, by the driver. Empty unless
    /// [`DeviceOptions::reports_kernels`] asked for it and the driver has
    /// `VK_KHR_pipeline_executable_properties`.
    #[must_use]
    pub fn kernel_reports(&self) -> Vec<KernelReport> {
        self.0.kernels.reports()
    }

    /// True if kernels that were kept from an earlier start were there, whole and this driver's.
    #[must_use]
    pub fn has_kept_kernels(&self) -> bool {
        self.0.context.pipelines.was_read()
    }

    /// True if `other` is the same opened device: buffers of one are of no use to another.
    #[must_use]
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }

    /// True if work for [`QueueRole::Update`] has a queue of its own.
    #[must_use]
    pub fn has_update_queue(&self) -> bool {
        !Arc::ptr_eq(&self.0.main, &self.0.update)
    }

    /// True if buffers ([`MemoryKind::Exported`]) and timelines can be exported to another API on
    /// this device.
    #[must_use]
    pub fn can_export(&self) -> bool {
        self.0.context.exports.is_some()
    }

    /// The timeline that counts the submissions to the queue of `role`, for another API to wait on:
    /// an opaque descriptor, as of a timeline semaphore.
    ///
    /// # Errors
    /// Returns an error if the device cannot export.
    pub fn export_timeline(&self, role: QueueRole) -> Result<OwnedFd, GpuError> {
        self.0
            .context
            .exports()?
            .semaphore_descriptor(self.0.queue(role).timeline)
    }

    /// Memory in use by purpose. What finished work held is given back first.
    #[must_use]
    pub fn memory(&self) -> MemoryReport {
        self.0.reap();
        self.0.context.memory_report()
    }

    /// Names of the calls of Vulkan functions that can fail, in order; empty without a drill in
    /// which one of them does.
    #[must_use]
    pub fn drilled_calls(&self) -> Vec<&'static str> {
        let drill = self.0.context.drill.as_ref();
        drill.map(DrillState::calls).unwrap_or_default()
    }

    /// Warnings and errors of the validation layer since the last call; nothing where validation is
    /// off.
    #[must_use]
    pub fn take_validation_messages(&self) -> Vec<String> {
        self.0.context.take_messages()
    }

    /// A buffer of `len` values with undefined content. `name` is what debuggers and errors call
    /// it, `purpose` what its bytes are counted under.
    ///
    /// # Errors
    /// Returns an error if memory is used up, or the buffer is longer than a kernel can see
    /// (`storage_buffer_bytes_max`).
    pub fn buffer<T: Pod>(
        &self,
        name: &'static str,
        purpose: &'static str,
        len: usize,
        memory_kind: MemoryKind,
    ) -> Result<Buffer<T>, GpuError> {
        let byte_len = (len as u64).saturating_mul(size_of::<T>() as u64);
        self.0.reap();
        let memory = BufferMemory::new(&self.0.context, name, purpose, byte_len, memory_kind)?;
        Ok(Buffer::new(Arc::new(memory), len))
    }

    /// A buffer on the device that holds `data`.
    ///
    /// # Errors
    /// Returns the errors of [`Gpu::buffer`], and one if the device is lost.
    pub fn upload<T: Pod>(
        &self,
        name: &'static str,
        purpose: &'static str,
        data: &[T],
    ) -> Result<Buffer<T>, GpuError> {
        let mut uploads = self.uploads();
        let buffer = uploads.upload(name, purpose, data)?;
        uploads.finish()?;
        Ok(buffer)
    }

    /// The way to the device for many buffers, which share their staging memory and are waited for
    /// once.
    #[must_use]
    pub fn uploads(&self) -> Uploads<'_> {
        Uploads::new(self, self.piece_bytes())
    }

    /// Writes `data` from element `first` of `buffer` on, behind everything submitted to the main
    /// queue before, and waits for it. Work on the update queue that uses the buffer must be done.
    ///
    /// # Errors
    /// Returns an error if memory for staging is used up or the device is lost.
    ///
    /// # Panics
    /// Panics if `data` does not fit.
    pub fn write<T: Pod>(
        &self,
        buffer: &Buffer<T>,
        first: usize,
        data: &[T],
    ) -> Result<(), GpuError> {
        let mut uploads = self.uploads();
        uploads.write(buffer, first, data)?;
        uploads.finish()
    }

    /// All values of `buffer`, behind everything submitted to the main queue before. Work on the
    /// update queue that writes the buffer must be done.
    ///
    /// # Errors
    /// Returns an error if memory for staging is used up or the device is lost.
    pub fn read<T: Pod>(&self, buffer: &Buffer<T>) -> Result<Vec<T>, GpuError> {
        transfer::read(self, buffer, self.piece_bytes())
    }

    /// Builds the kernel of the shader `S`. A kernel of the same shader with equal constants is
    /// the same one: it is not built again.
    ///
    /// # Errors
    /// Returns an error if the device lacks a feature that the shader uses, its workgroup is too
    /// large for the device, the driver cannot build it, or a kernel on trial that replaces it
    /// ([`DeviceOptions::trial`]) takes other buffers or push constants.
    pub fn kernel<S: Shader>(&self, constants: &S::Constants) -> Result<Kernel<S>, GpuError> {
        let kernels = &self.0.kernels;
        kernels.find_or_build(&self.0.context, constants)
    }

    /// Starts a list of commands.
    pub fn record(&self, role: QueueRole) -> Recorder {
        Recorder::new(&self.0.context, self.0.queue(role))
    }

    /// Submits what was recorded, to run behind `after` and behind everything submitted to the same
    /// queue before.
    ///
    /// # Errors
    /// Returns an error if the device is lost or memory is used up, and in a process that was
    /// forked from the one that opened the device.
    ///
    /// # Panics
    /// Panics if the recorder or a ticket belongs to another device.
    pub fn submit(&self, recorder: Recorder, after: &[&Ticket]) -> Result<Ticket, GpuError> {
        let ours = |context: &Arc<Context>| Arc::ptr_eq(context, &self.0.context);
        assert!(
            ours(&recorder.context),
            "the recorder belongs to another device"
        );
        assert!(
            after.iter().all(|ticket| ours(&ticket.queue.context)),
            "a ticket belongs to another device"
        );
        let queue = recorder.queue.clone();
        queue.submit(recorder.finish(), after)
    }

    /// Relates the device's clock to the host's. Waits for everything submitted to the main queue
    /// before.
    ///
    /// # Errors
    /// Returns an error if the device is lost, or the queue has no timestamps.
    pub fn clock(&self) -> Result<DeviceClock, GpuError> {
        let mut best: Option<DeviceClock> = None;
        // The shortest way there and back says most.
        for _ in 0..8 {
            let before = Instant::now();
            let ticket = self.submit(self.record(QueueRole::Main), &[])?;
            ticket.wait()?;
            let half = before.elapsed() / 2;
            let middle_ns = ticket.begin_ns()? + ticket.gpu_time_ns()? / 2;
            if best.is_none_or(|best| half < best.uncertainty) {
                best = Some(DeviceClock {
                    host: before + half,
                    device_ns: middle_ns,
                    uncertainty: half,
                });
            }
        }
        best.ok_or(GpuError::Driver {
            call: "reading the clock",
            code: "no measurement".into(),
        })
    }

    /// Staging is bound to nothing, and still a buffer like all others.
    fn piece_bytes(&self) -> usize {
        transfer::PIECE_BYTES.min(self.limits().storage_buffer_bytes_max as usize)
    }
}

impl Shared {
    fn queue(&self, role: QueueRole) -> &Arc<Queue> {
        match role {
            QueueRole::Main => &self.main,
            QueueRole::Update => &self.update,
        }
    }

    /// A failure is a device lost, which the next submission or wait reports.
    fn reap(&self) {
        let _ = self.main.reap();
        let _ = self.update.reap();
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        // A lost or hung device has nobody left to be told; the queues' own drops decide what is
        // sound to free.
        let _ = self.main.wait_idle();
        let _ = self.update.wait_idle();
    }
}
