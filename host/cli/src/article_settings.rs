//! Settings of the article's method: an option of `scan`, `article` and `register` that names their file.

use std::path::PathBuf;

use flankscope_article::ArticleSettings;

use crate::geometry::pose_of_pairs;

/// Settings of the article's method. They act on views that are kept: a session is stitched anew with others.
#[derive(clap::Args, Clone, Debug)]
pub struct ArticleSettingsFile {
    /// Settings of the article's method; `flankscope article --write-settings FILE` writes the article's own [default: those,
    /// without the denoising of its toolbox]
    #[arg(long, value_name = "SETTINGS.toml")]
    pub article_settings: Option<PathBuf>,
}

impl ArticleSettingsFile {
    /// The settings in the file, with `seed` for random numbers.
    pub fn load(&self, seed: u64) -> anyhow::Result<ArticleSettings> {
        let file = self.article_settings.as_deref();
        let file = file.map(ArticleSettings::load).transpose()?;
        let mut settings = file.unwrap_or_default();
        settings.registration.seed = seed;
        settings.first_pose = settings.pairs.as_deref().map(pose_of_pairs).transpose()?;
        Ok(settings)
    }
}
