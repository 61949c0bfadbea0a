//! `--grid`: what a point is made of.

use anyhow::ensure;
use flankscope_profilometry::HeadModel;

/// What a point is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Grid {
    /// Blocks of pixels: for a lens.
    Pixel,
    /// Cores of the head's map: for a fibre bundle.
    Core,
}

impl Grid {
    /// Sets the head's decoding grid.
    pub fn impose(self, head: &mut HeadModel) -> anyhow::Result<()> {
        match self {
            Self::Pixel => head.core_map = None,
            Self::Core => {
                ensure!(
                    head.core_map.is_some(),
                    "--grid core: the head has no core map; add [cores] to head.toml, or use --grid pixel"
                );
            }
        }
        Ok(())
    }
}
