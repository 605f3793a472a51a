//! Kernels in other forms than the program's, for measurements during development, and what the
//! driver says of kernels.

use std::fmt;
use std::path::Path;

use ash::{khr, vk};

use crate::{Constant, GpuError, instance::Instance};

/// Kernels that replace those of the program while a device is open, and values that replace
/// specialization constants.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct KernelTrial {
    /// Name of a kernel, and the SPIR-V that is used for it.
    spirv: Vec<(String, Vec<u32>)>,
    /// Name of a kernel, of its constant, and the value as text.
    constants: Vec<(String, String, String)>,
}

impl KernelTrial {
    /// Reads `NAME.spv` for each kernel that is replaced, and `constants.txt`, if it is there, with
    /// lines of the form `KERNEL.CONSTANT=VALUE`.
    ///
    /// # Errors
    /// Returns an error if the folder or a file cannot be read, a file is no SPIR-V, or a line is
    /// not of that form.
    pub fn from_folder(folder: &Path) -> Result<Self, GpuError> {
        let refuse = |path: &Path, reason: String| GpuError::Trial {
            path: path.to_owned(),
            reason,
        };
        let unreadable =
            |path: &Path, error: std::io::Error| refuse(path, format!("cannot be read: {error}"));
        let mut trial = Self::default();
        let entries = std::fs::read_dir(folder).map_err(|error| unreadable(folder, error))?;
        for entry in entries {
            let path = entry.map_err(|error| unreadable(folder, error))?.path();
            let read = || std::fs::read(&path).map_err(|error| unreadable(&path, error));
            let stem = path.file_stem().unwrap_or_default().to_string_lossy();
            if path.extension().is_some_and(|extension| extension == "spv") {
                let bytes = read()?;
                if bytes.len() % 4 != 0 || !bytes.starts_with(&SPIRV_MAGIC) {
                    return Err(refuse(&path, "is no SPIR-V of this byte order".into()));
                }
                let words = bytemuck::pod_collect_to_vec(&bytes);
                trial.spirv.push((stem.into_owned(), words));
            } else if path.ends_with("constants.txt") {
                let text = String::from_utf8_lossy(&read()?).into_owned();
                for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
                    let parts = line.split_once('=').and_then(|(name, value)| {
                        let (kernel, constant) = name.trim().split_once('.')?;
                        Some((
                            kernel.to_owned(),
                            constant.to_owned(),
                            value.trim().to_owned(),
                        ))
                    });
                    let Some(parts) = parts else {
                        return Err(refuse(
                            &path,
                            format!("expected KERNEL.CONSTANT=VALUE, found '{line}'"),
                        ));
                    };
                    trial.constants.push(parts);
                }
            }
        }
        Ok(trial)
    }

    /// SPIR-V that replaces the kernel `name`; `None` where the program's is used.
    pub(crate) fn spirv(&self, name: &str) -> Option<&[u32]> {
        let found = self.spirv.iter().find(|(kernel, _)| kernel == name);
        found.map(|(_, words)| words.as_slice())
    }

    /// `constants` of the kernel `name` with the values that replace them.
    pub(crate) fn constants<'a>(
        &self,
        name: &str,
        constants: &[(&'a str, Constant)],
    ) -> Result<Vec<(&'a str, Constant)>, GpuError> {
        let mut replaced = constants.to_vec();
        for (_, constant, value) in self.constants.iter().filter(|(kernel, ..)| kernel == name) {
            let Some((_, current)) = replaced.iter_mut().find(|(known, _)| known == constant)
            else {
                continue;
            };
            *current = current.parsed_alike(value).ok_or_else(|| GpuError::Trial {
                path: "constants.txt".into(),
                reason: format!("{name}.{constant} is {current:?} in the program, found '{value}'"),
            })?;
        }
        Ok(replaced)
    }
}

/// First bytes of SPIR-V, little-endian.
const SPIRV_MAGIC: [u8; 4] = 0x0723_0203_u32.to_le_bytes();

/// Figures of a kernel by the driver, where it has `VK_KHR_pipeline_executable_properties`.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelReport {
    /// Name of the kernel.
    pub name: &'static str,
    /// Invocations of a workgroup.
    pub workgroup_threads: u32,
    /// Specialization constants that it was built with, by name.
    pub constants: Vec<(String, Constant)>,
    /// Figures of the driver, by the driver's own names. Empty where it has none.
    pub figures: Vec<(String, f64)>,
}

impl KernelReport {
    /// The driver's figure whose name has all of `words`, in any case.
    #[must_use]
    pub fn figure(&self, words: &[&str]) -> Option<f64> {
        let has = |name: &str| words.iter().all(|word| name.to_lowercase().contains(word));
        let found = self.figures.iter().find(|(name, _)| has(name));
        found.map(|&(_, value)| value)
    }
}

impl fmt::Display for Constant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::U32(value) => write!(f, "{value}"),
            Self::I32(value) => write!(f, "{value}"),
            Self::F32(value) => write!(f, "{value}"),
            Self::Bool(value) => write!(f, "{value}"),
        }
    }
}

/// Functions that ask the driver about kernels.
pub(crate) struct ExecutableProperties(khr::pipeline_executable_properties::Device);

impl ExecutableProperties {
    /// For a device that has the extension and its feature enabled.
    pub(crate) fn new(instance: &Instance, device: &ash::Device) -> Self {
        Self(khr::pipeline_executable_properties::Device::new(
            &instance.raw,
            device,
        ))
    }

    /// Figures of `pipeline`, which was made with the flag that captures them.
    pub(crate) fn figures(&self, pipeline: vk::Pipeline) -> Vec<(String, f64)> {
        let of_pipeline = vk::PipelineInfoKHR::default().pipeline(pipeline);
        // SAFETY: the pipeline is live and of this device, which has the extension.
        let executables = unsafe { self.0.get_pipeline_executable_properties(&of_pipeline) };
        let count = executables.unwrap_or_default().len() as u32;
        let of_executable = |index: u32| {
            let info = vk::PipelineExecutableInfoKHR::default()
                .pipeline(pipeline)
                .executable_index(index);
            // SAFETY: as above, and the pipeline has that many executables.
            unsafe { self.0.get_pipeline_executable_statistics(&info) }.unwrap_or_default()
        };
        let all = (0..count).flat_map(of_executable);
        all.map(|statistic| {
            let name = statistic.name_as_c_str().unwrap_or_default();
            (name.to_string_lossy().into_owned(), value_of(&statistic))
        })
        .collect()
    }
}

fn value_of(statistic: &vk::PipelineExecutableStatisticKHR<'_>) -> f64 {
    use vk::PipelineExecutableStatisticFormatKHR as Format;
    match statistic.format {
        // SAFETY: the format says which member of the union the driver wrote.
        Format::INT64 => unsafe { statistic.value.i64 as f64 },
        // SAFETY: as above.
        Format::FLOAT64 => unsafe { statistic.value.f64 },
        // SAFETY: as above.
        Format::BOOL32 => f64::from(unsafe { statistic.value.b32 }),
        // SAFETY: as above; UINT64 is the only other format.
        _ => unsafe { statistic.value.u64 as f64 },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_read_and_replace_what_they_name() {
        let folder = std::env::temp_dir().join(format!("trial-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(
            folder.join("blend.spv"),
            [SPIRV_MAGIC, [1, 0, 0, 0]].concat(),
        )
        .unwrap();
        std::fs::write(
            folder.join("constants.txt"),
            "blend.BATCH = 256\n\nscan.X=1\n",
        )
        .unwrap();
        let trial = KernelTrial::from_folder(&folder).unwrap();
        assert_eq!(trial.spirv("blend"), Some(&[0x0723_0203, 1][..]));
        assert_eq!(trial.spirv("scan"), None);
        let constants = [
            ("BATCH", Constant::U32(1024)),
            ("DEPTH", Constant::Bool(false)),
        ];
        let replaced = trial.constants("blend", &constants).unwrap();
        assert_eq!(replaced, [("BATCH", Constant::U32(256)), constants[1]]);
        assert_eq!(trial.constants("cull", &constants).unwrap(), constants);

        for (file, content) in [
            ("constants.txt", "blend.BATCH"),
            ("constants.txt", "BATCH=1"),
            ("blend.spv", "not SPIR-V."),
        ] {
            std::fs::write(folder.join(file), content).unwrap();
            let error = KernelTrial::from_folder(&folder).unwrap_err().to_string();
            assert!(error.contains(file), "{error}");
            std::fs::remove_file(folder.join(file)).unwrap();
        }
        std::fs::write(folder.join("constants.txt"), "blend.BATCH=many").unwrap();
        let trial = KernelTrial::from_folder(&folder).unwrap();
        let error = trial.constants("blend", &constants).unwrap_err();
        assert!(error.to_string().contains("'many'"), "{error}");
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(KernelTrial::from_folder(&folder).is_err());
    }
}
