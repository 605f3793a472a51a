//! `meta.json`: what the images mean.

use serde::{Deserialize, Serialize};

use crate::DecodeError;

/// Entries of a codebook.
pub(super) const CODES: usize = 256;
/// Entries of the palette of coefficients: as many as 16 bits tell.
pub(super) const PALETTE_MAX: u64 = 1 << 16;

/// Means: the extent of their logarithms, and images of the low and the high bytes.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Means {
    pub(super) mins: [f32; 3],
    pub(super) maxs: [f32; 3],
    pub(super) files: [String; 2],
}

/// Images of indices into a codebook.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Coded {
    pub(super) codebook: Vec<f32>,
    pub(super) files: [String; 1],
}

/// An image without a codebook.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Plain {
    pub(super) files: [String; 1],
}

/// Coefficients after DC: images of the palette and of which entry each splat has.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Rest {
    pub(super) count: u64,
    pub(super) bands: u8,
    pub(super) codebook: Vec<f32>,
    pub(super) files: [String; 2],
}

/// The whole of `meta.json`. What else stands in it (who wrote it, `antialias`) changes no splat.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Meta {
    pub(super) version: u64,
    pub(super) count: u64,
    pub(super) means: Means,
    pub(super) scales: Coded,
    pub(super) quats: Plain,
    pub(super) sh0: Coded,
    #[serde(rename = "shN", skip_serializing_if = "Option::is_none")]
    pub(super) rest: Option<Rest>,
}

impl Meta {
    /// Reads and checks the text.
    pub(super) fn parse(text: &[u8]) -> Result<Self, DecodeError> {
        /// Version field, read first: other versions have other fields.
        #[derive(Deserialize)]
        struct Version {
            version: Option<u64>,
        }
        let malformed =
            |error: serde_json::Error| DecodeError::Malformed(format!("meta.json: {error}"));
        match serde_json::from_slice::<Version>(text)
            .map_err(malformed)?
            .version
        {
            Some(2) => {}
            found => {
                let found = found.map_or_else(
                    || "1 (it names none)".to_owned(),
                    |version| version.to_string(),
                );
                let message = format!(
                    "SOG of version {found}; version 2 is read: write the file again with splat-transform"
                );
                return Err(DecodeError::Unsupported(message));
            }
        }
        let meta: Self = serde_json::from_slice(text).map_err(malformed)?;
        meta.check()
            .map_err(|message| DecodeError::Malformed(format!("meta.json: {message}")))?;
        Ok(meta)
    }

    /// The images that are named.
    pub(super) fn files(&self) -> impl Iterator<Item = &str> {
        let rest = self.rest.iter().flat_map(|rest| &rest.files);
        let files = self
            .means
            .files
            .iter()
            .chain(&self.scales.files)
            .chain(&self.quats.files)
            .chain(&self.sh0.files);
        files.chain(rest).map(String::as_str)
    }

    fn check(&self) -> Result<(), String> {
        let finite = |values: &[f32], what: &str| {
            let all = values.iter().all(|value| value.is_finite());
            if all {
                Ok(())
            } else {
                Err(format!("{what} is not finite"))
            }
        };
        finite(&self.means.mins, "means.mins")?;
        finite(&self.means.maxs, "means.maxs")?;
        let rest = self
            .rest
            .as_ref()
            .map(|rest| (&rest.codebook, "shN.codebook"));
        for (codebook, what) in [
            (&self.scales.codebook, "scales.codebook"),
            (&self.sh0.codebook, "sh0.codebook"),
        ]
        .into_iter()
        .chain(rest)
        {
            finite(codebook, what)?;
            if codebook.is_empty() || codebook.len() > CODES {
                return Err(format!(
                    "{what} has {} entries, expected 1 to {CODES}",
                    codebook.len()
                ));
            }
        }
        match &self.rest {
            Some(rest) if rest.bands > 3 => {
                Err(format!("shN.bands is {}, expected 0 to 3", rest.bands))
            }
            Some(rest) if rest.count > PALETTE_MAX => Err(format!(
                "shN.count is {}, expected at most {PALETTE_MAX}",
                rest.count
            )),
            _ => Ok(()),
        }
    }
}
