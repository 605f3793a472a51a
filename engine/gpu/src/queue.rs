//! Queues: submitting, waiting, and taking back what the device is done with.
//!
//! Each queue has one timeline semaphore that counts submissions. A submission of the same queue
//! needs no wait: it starts with a full barrier. One of the other queue becomes a semaphore wait.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use ash::vk;

use crate::{
    DeviceKind, GpuError,
    commands::CommandList,
    context::Context,
    error::failed,
    export,
    slot::CommandSlot,
    ticket::{Submission, Ticket},
};

/// Role of the queue of a command buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QueueRole {
    /// The frame.
    Main,
    /// Work beside the frame, on the compute-only family if the device has one, else on the main
    /// queue.
    Update,
}

/// Time after which work counts as hung. Drivers of real GPUs give up within seconds; the CPU
/// driver on a loaded machine has been seen to take a minute for one large frame.
const HANG_AFTER: Duration = Duration::from_secs(300);

/// Interval between checks how far waiting work has come: short enough to know the last stage when
/// the device is lost.
const LOOK_EVERY: Duration = Duration::from_millis(200);

/// Command slots kept for what they have recorded: those of a few frames in flight, drawings of
/// several sizes and sweeps.
const RECORDED_SLOTS_MAX: usize = 16;

/// Command slots kept to be recorded; more are in flight only in a burst of uploads.
const SPENT_SLOTS_MAX: usize = 4;

/// Empty lists kept for the room of their vectors.
const SPARE_LISTS_MAX: usize = 4;

pub(crate) struct Queue {
    pub(crate) context: Arc<Context>,
    pub(crate) timeline: vk::Semaphore,
    raw: vk::Queue,
    family: u32,
    timestamp_bits: u32,
    /// The process that opened the device.
    process: u32,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// The last value that the timeline was told to count to.
    submitted: u64,
    in_flight: VecDeque<(u64, CommandSlot, Arc<Submission>)>,
    /// Free slots whose commands may come again; the one whose work was done first comes first.
    recorded: VecDeque<CommandSlot>,
    /// Free slots whose commands will not.
    spent: Vec<CommandSlot>,
    spare: Vec<CommandList>,
}

impl Queue {
    /// The first queue of `family`, which the device was opened with.
    pub(crate) fn new(
        context: &Arc<Context>,
        family: u32,
        timestamp_bits: u32,
    ) -> Result<Self, GpuError> {
        let mut timeline =
            vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let mut export = export::semaphore_info();
        let mut create = vk::SemaphoreCreateInfo::default().push_next(&mut timeline);
        if context.abilities.exports {
            create = create.push_next(&mut export);
        }
        // SAFETY: timeline semaphores are required of every device, and those of this one can be
        // exported where it is asked for.
        let timeline = context.call("vkCreateSemaphore", || unsafe {
            context.device.create_semaphore(&create, None)
        })?;
        // SAFETY: the device was opened with one queue of this family.
        let raw = unsafe { context.device.get_device_queue(family, 0) };
        Ok(Self {
            context: context.clone(),
            timeline,
            raw,
            family,
            timestamp_bits,
            process: std::process::id(),
            state: Mutex::default(),
        })
    }

    /// A list to record into.
    pub(crate) fn spare_list(&self) -> CommandList {
        self.state().spare.pop().unwrap_or_default()
    }

    /// A slot that does what `list` says, and whether it was recorded before: a free one that was
    /// recorded from an equal list, else one that is spent, else a new one. When there are too
    /// many, the one that was not used for the longest time is recorded again.
    fn slot_for(&self, list: CommandList) -> Result<(CommandSlot, bool), GpuError> {
        // A child would wait for threads that it does not have.
        if std::process::id() != self.process {
            return Err(GpuError::Forked);
        }
        self.reap()?;
        let mut state = self.state();
        let equal = state
            .recorded
            .iter()
            .position(|slot| slot.does(&list.commands));
        if let Some(mut slot) = equal.and_then(|index| state.recorded.remove(index)) {
            let mut spare = slot.repeat(list);
            if state.spare.len() < SPARE_LISTS_MAX {
                spare.clear();
                state.spare.push(spare);
            }
            return Ok((slot, true));
        }
        let free = if state.recorded.len() >= RECORDED_SLOTS_MAX {
            state.recorded.pop_front()
        } else {
            state.spent.pop()
        };
        drop(state);
        let mut slot = match free {
            Some(slot) => slot,
            None => CommandSlot::new(&self.context, self.family, self.timestamp_bits > 0)?,
        };
        slot.record(list)?;
        Ok((slot, false))
    }

    /// Submits what `list` says behind `after`.
    pub(crate) fn submit(
        self: &Arc<Self>,
        list: CommandList,
        after: &[&Ticket],
    ) -> Result<Ticket, GpuError> {
        if let Some(drill) = &self.context.drill {
            drill.submission()?;
        }
        let (slot, repeated) = self.slot_for(list)?;
        let waits: Vec<vk::SemaphoreSubmitInfo<'_>> = after
            .iter()
            .filter(|ticket| !Arc::ptr_eq(&ticket.queue, self))
            .map(|ticket| semaphore_at(ticket.queue.timeline, ticket.value))
            .collect();
        let (stages, timed) = (slot.stages.clone(), slot.times_stages());
        let submission = Arc::new(Submission::new(stages, timed, repeated));
        let mut state = self.state();
        let value = state.submitted + 1;
        let commands = [vk::CommandBufferSubmitInfo::default().command_buffer(slot.commands)];
        let signals = [semaphore_at(self.timeline, value)];
        let submit = vk::SubmitInfo2::default()
            .wait_semaphore_infos(&waits)
            .command_buffer_infos(&commands)
            .signal_semaphore_infos(&signals);
        // SAFETY: the state's lock makes us the only user of the queue; the command buffer is
        // recorded, of live buffers and kernels, and not pending, and the slot with all that it
        // uses stays in flight until the timeline has its value.
        let submitted = self.context.code_of("vkQueueSubmit2", || unsafe {
            let device = &self.context.device;
            device.queue_submit2(self.raw, &[submit], vk::Fence::null())
        });
        match submitted {
            Ok(()) => {
                state.submitted = value;
                state.in_flight.push_back((value, slot, submission.clone()));
                Ok(Ticket {
                    queue: self.clone(),
                    value,
                    submission,
                })
            }
            Err(code) => Err(self.explain(&state, "vkQueueSubmit2", code)),
        }
    }

    /// Waits until the timeline has `value`.
    pub(crate) fn wait(&self, value: u64, submission: &Submission) -> Result<(), GpuError> {
        let (semaphores, values) = ([self.timeline], [value]);
        let wait = vk::SemaphoreWaitInfo::default()
            .semaphores(&semaphores)
            .values(&values);
        if self.polled(value, self.context.poll)? {
            return self.reap();
        }
        let since = Instant::now();
        loop {
            // SAFETY: the semaphore lives as long as this queue, and was told to count to `value`.
            let waited = self.context.code_of("vkWaitSemaphores", || unsafe {
                let device = &self.context.device;
                device.wait_semaphores(&wait, LOOK_EVERY.as_nanos() as u64)
            });
            match waited {
                Ok(()) => return self.reap(),
                Err(vk::Result::TIMEOUT) => self.look(&self.state()),
                Err(code) => return Err(self.explain(&self.state(), "vkWaitSemaphores", code)),
            }
            if since.elapsed() > HANG_AFTER {
                return Err(GpuError::Hang {
                    seconds: HANG_AFTER.as_secs(),
                    progress: submission.progress(),
                });
            }
        }
    }

    /// Asks the device for at most `limit` whether the timeline has `value`.
    fn polled(&self, value: u64, limit: Duration) -> Result<bool, GpuError> {
        let since = Instant::now();
        while since.elapsed() < limit {
            if self.is_done(value)? {
                return Ok(true);
            }
            std::thread::yield_now();
        }
        Ok(false)
    }

    pub(crate) fn is_done(&self, value: u64) -> Result<bool, GpuError> {
        Ok(self.counted(&self.state())? >= value)
    }

    /// Waits for everything submitted.
    pub(crate) fn wait_idle(&self) -> Result<(), GpuError> {
        let last = self
            .state()
            .in_flight
            .back()
            .map(|(value, _, submission)| (*value, submission.clone()));
        last.map_or(Ok(()), |(value, submission)| self.wait(value, &submission))
    }

    /// Takes back what the device is done with, and its times.
    pub(crate) fn reap(&self) -> Result<(), GpuError> {
        let mut state = self.state();
        if state.in_flight.is_empty() {
            return Ok(());
        }
        let counted = self.counted(&state)?;
        while state
            .in_flight
            .front()
            .is_some_and(|(value, ..)| *value <= counted)
        {
            let Some((_, mut slot, submission)) = state.in_flight.pop_front() else {
                break;
            };
            submission.finish(
                &slot,
                self.timestamp_bits,
                self.context.limits.timestamp_period_ns,
            );
            slot.release();
            if !slot.is_spent() {
                state.recorded.push_back(slot);
            } else if state.spent.len() < SPENT_SLOTS_MAX {
                state.spent.push(slot);
            }
        }
        Ok(())
    }

    fn counted(&self, state: &State) -> Result<u64, GpuError> {
        // SAFETY: a query on a live semaphore.
        let counted = self
            .context
            .code_of("vkGetSemaphoreCounterValue", || unsafe {
                let device = &self.context.device;
                device.get_semaphore_counter_value(self.timeline)
            });
        counted.map_err(|code| self.explain(state, "vkGetSemaphoreCounterValue", code))
    }

    /// Polls the progress of the device. Not on CPU devices: lavapipe (Mesa 22.3) answers only when
    /// it is idle, which would make waiting for a hung kernel endless.
    fn look(&self, state: &State) {
        if self.context.info.kind == DeviceKind::Cpu {
            return;
        }
        if let Some((_, slot, submission)) = state.in_flight.front() {
            submission.look(slot);
        }
    }

    fn explain(&self, state: &State, during: &'static str, code: vk::Result) -> GpuError {
        if code != vk::Result::ERROR_DEVICE_LOST {
            return failed(during)(code);
        }
        self.look(state);
        let progress = state
            .in_flight
            .front()
            .map(|(_, _, submission)| submission.progress());
        GpuError::DeviceLost {
            during,
            progress: progress.unwrap_or_else(|| "nothing was in flight".into()),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Queue {
    fn drop(&mut self) {
        if let Err(GpuError::Hang { .. }) = self.wait_idle() {
            // The device still uses these: leaking them is the only sound thing left.
            std::mem::forget(std::mem::take(&mut self.state().in_flight));
            return;
        }
        // SAFETY: the device is idle or lost, and every ticket that knew the semaphore held this
        // queue.
        unsafe { self.context.device.destroy_semaphore(self.timeline, None) };
    }
}

fn semaphore_at(semaphore: vk::Semaphore, value: u64) -> vk::SemaphoreSubmitInfo<'static> {
    vk::SemaphoreSubmitInfo::default()
        .semaphore(semaphore)
        .value(value)
        .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use crate::{DeviceKind, DeviceOptions, Gpu, Kernel, QueueRole};

    /// A kernel that takes a while.
    mod spin {
        crate::shader! {
            "spin", {
                let bytes = include_bytes!("../tests/kernels/spin.spv").as_chunks::<4>().0;
                let words = bytes.iter().map(|word| u32::from_le_bytes(*word));
                words.collect::<Vec<u32>>().leak()
            };
            entry_point: "main";
            workgroup: [(64, None), (1, None), (1, None)];
            capabilities: [1];
            bindings {
                0 values: u32, ReadWrite, None;
            }
            push 8 {
                0 count: u32;
                4 rounds: u32;
            }
            constants {
            }
        }
    }

    /// A lost device is reported with the last poll while work ran, as there may be none
    /// afterwards.
    #[test]
    fn a_look_at_running_work_tells_the_stages_that_are_done() {
        let gpu = Gpu::open(&DeviceOptions::default()).unwrap();
        let spin: Kernel<spin::Module> = gpu.kernel(&spin::Constants {}).unwrap();
        let values = gpu.upload("values", "test", &vec![1_u32; 1 << 15]).unwrap();
        let mut recorder = gpu.record(QueueRole::Main).time_stages();
        for (name, rounds) in [("short", 1_u32), ("long", 50_000)] {
            let push = spin::Push {
                count: 1 << 15,
                rounds,
            };
            recorder.stage(name, |recorder| {
                let bindings = spin::Bindings {
                    values: values.bound(),
                };
                recorder.dispatch(&spin, bindings, push, [512, 1, 1]);
            });
        }
        let ticket = gpu.submit(recorder, &[]).unwrap();
        ticket.queue.look(&ticket.queue.state());
        // Seconds of work: a look that waits for it would be no use when the device hangs.
        assert!(!ticket.is_done().unwrap());
        let poll = |limit_s| {
            ticket
                .queue
                .polled(ticket.value, Duration::from_secs_f64(limit_s))
        };
        assert!(!poll(0.0).unwrap() && !poll(1e-3).unwrap());
        let mut seen = vec![ticket.submission.progress()];
        while !ticket.is_done().unwrap() {
            ticket.queue.look(&ticket.queue.state());
            seen.push(ticket.submission.progress());
            std::thread::sleep(Duration::from_millis(1));
        }
        let between = "the last stage known to have finished is 'short', the next is 'long'";
        assert!(
            gpu.info().kind == DeviceKind::Cpu || seen.iter().any(|progress| progress == between),
            "{seen:#?}"
        );
        assert!(poll(60.0).unwrap());
        ticket.wait().unwrap();
        assert_eq!(
            ticket.submission.progress(),
            "the last stage known to have finished is 'long'"
        );
    }
}
