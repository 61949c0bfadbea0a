//! The lake: a folder, or a bucket of an object store. Files are put whole or not at all, and never changed.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use futures_util::TryStreamExt;
use object_store::local::LocalFileSystem;
use object_store::path::Path as ObjectPath;
use object_store::{
    Error as StoreError, GetOptions, ObjectStore, ObjectStoreExt, PutMode, PutPayload,
};

use crate::file::{FileError, LakeFile};
use crate::name::{Cover, FileName, cover};
use crate::retired::{Retired, kept};
use crate::sums::SumsName;

/// Why the lake cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LakeError {
    #[error("lake {url}: {source}")]
    Open {
        url: String,
        /// Cause.
        source: StoreError,
    },
    #[error(
        "lake {url}: this build knows folders only; a build with `--features s3` knows s3://BUCKET/PREFIX, too"
    )]
    NoS3 { url: String },
    #[error("lake {url}: neither a folder nor s3://BUCKET/PREFIX")]
    Scheme { url: String },
    #[error("lake {}: {source}; name an existing folder", path.display())]
    Folder {
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    #[error("the lake's store: {0}")]
    Store(#[from] StoreError),
    #[error("{name}: {source}")]
    File {
        name: Box<FileName>,
        /// Cause.
        source: FileError,
    },
}

/// A file of a listing.
#[derive(Clone, Debug)]
pub struct Listed {
    pub name: FileName,
    pub bytes: u64,
    /// When it was put, by the store's clock: milliseconds since 1970.
    pub put_ms: i64,
}

/// What a listing of the lake found.
#[derive(Debug, Default)]
pub struct Listing {
    pub files: Vec<Listed>,
    pub retired: Vec<Retired>,
    /// Sums of days, whether or not they are of the files that count now.
    pub sums: Vec<SumsName>,
    /// Objects that this program does not write.
    pub foreign: Vec<String>,
}

impl Listing {
    /// Which of the files count, but for those that were given up.
    #[must_use]
    pub fn cover(&self) -> Cover {
        let names = self.files.iter().map(|file| file.name.clone());
        cover(kept(names, &self.retired))
    }
}

/// Where other programs find the files of a lake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// The object store: `file:///`, or `s3://BUCKET/`.
    pub store: String,
    /// What precedes the names of files in the store.
    pub prefix: ObjectPath,
}

/// A lake.
#[derive(Clone, Debug)]
pub struct Lake {
    store: Arc<dyn ObjectStore>,
    prefix: ObjectPath,
    folder: Option<PathBuf>,
    address: Option<Address>,
}

impl Lake {
    /// Opens a lake: a folder, or `s3://BUCKET/PREFIX` in a build with `s3`, whose credentials are in the environment (`AWS_…`).
    ///
    /// # Errors
    /// There is no such folder, or the address is not understood.
    pub fn open(url: &str) -> Result<Self, LakeError> {
        if url.starts_with("s3://") {
            return s3(url);
        }
        if url.contains("://") {
            return Err(LakeError::Scheme { url: url.into() });
        }
        let path = Path::new(url);
        let folder = path.canonicalize().map_err(|source| LakeError::Folder {
            path: path.to_owned(),
            source,
        })?;
        let open = |source| LakeError::Open {
            url: url.into(),
            source,
        };
        let prefix = ObjectPath::from_absolute_path(&folder);
        let store = LocalFileSystem::new_with_prefix(&folder)
            .map_err(open)?
            // A file that is there survives a power cut.
            .with_fsync(true);
        Ok(Self {
            store: Arc::new(store),
            prefix: ObjectPath::default(),
            folder: Some(folder),
            address: Some(Address {
                store: "file:///".into(),
                prefix: prefix.map_err(|error| open(error.into()))?,
            }),
        })
    }

    /// A lake in any store, below a prefix.
    #[must_use]
    pub fn in_store(store: Arc<dyn ObjectStore>, prefix: ObjectPath) -> Self {
        Self {
            store,
            prefix,
            folder: None,
            address: None,
        }
    }

    /// Where other programs find its files; `None` for a store in this process.
    #[must_use]
    pub fn address(&self) -> Option<&Address> {
        self.address.as_ref()
    }

    /// The folder, if it is one.
    #[must_use]
    pub fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    fn path(&self, name: &str) -> Result<ObjectPath, LakeError> {
        let path = format!("{}/{name}", self.prefix);
        ObjectPath::parse(path.trim_start_matches('/'))
            .map_err(|error| LakeError::Store(error.into()))
    }

    /// Everything in the lake, or of one station.
    ///
    /// # Errors
    /// The store cannot be listed, or the folder is gone, which the store would take for an empty one.
    pub async fn list(&self, station: Option<&str>) -> Result<Listing, LakeError> {
        if let Some(path) = &self.folder {
            std::fs::read_dir(path).map_err(|source| LakeError::Folder {
                path: path.clone(),
                source,
            })?;
        }
        let mut found = Listing::default();
        let prefix = match station {
            Some(station) => self.path(&FileName::station_folder(station))?,
            None => self.prefix.clone(),
        };
        let mut objects = self.store.list(Some(&prefix));
        while let Some(object) = objects.try_next().await? {
            let path = object.location.as_ref();
            let below = path.strip_prefix(self.prefix.as_ref()).unwrap_or(path);
            let below = below.trim_start_matches('/');
            if let Some(name) = FileName::parse(below) {
                found.files.push(Listed {
                    name,
                    bytes: object.size,
                    put_ms: object.last_modified.timestamp_millis(),
                });
            } else if let Some(retired) = Retired::parse(below) {
                found.retired.push(retired);
            } else if let Some(sums) = SumsName::parse(below) {
                found.sums.push(sums);
            } else {
                found.foreign.push(below.to_owned());
            }
        }
        Ok(found)
    }

    /// The marks of what was given up on purpose.
    ///
    /// # Errors
    /// The store cannot be listed.
    pub async fn retired(&self) -> Result<Vec<Retired>, LakeError> {
        let prefix = self.path(Retired::FOLDER)?;
        let objects: Vec<_> = self.store.list(Some(&prefix)).try_collect().await?;
        let below = |path: &ObjectPath| {
            let path = path.as_ref();
            let path = path.strip_prefix(self.prefix.as_ref()).unwrap_or(path);
            Retired::parse(path.trim_start_matches('/'))
        };
        Ok(objects
            .iter()
            .filter_map(|object| below(&object.location))
            .collect())
    }

    /// Puts an object unless it is there; false if it was.
    ///
    /// # Errors
    /// The store refuses it, or is full. Nothing of it is there then.
    pub async fn put(&self, name: &str, bytes: Vec<u8>) -> Result<bool, LakeError> {
        let path = self.path(name)?;
        let payload = PutPayload::from(bytes);
        let put = self
            .store
            .put_opts(&path, payload.clone(), PutMode::Create.into());
        match put.await {
            Ok(_) => Ok(true),
            Err(StoreError::AlreadyExists { .. }) => Ok(false),
            // A store without conditions: the same name is the same rows, so it does no harm to put them again.
            Err(StoreError::NotImplemented { .. } | StoreError::NotSupported { .. }) => {
                self.store.put(&path, payload).await?;
                Ok(true)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Reads a file and compares its rows with its name.
    ///
    /// # Errors
    /// It cannot be read, or is not believed.
    pub async fn read(&self, name: &FileName) -> Result<LakeFile, LakeError> {
        let path = self.path(&name.to_string())?;
        let bytes: Bytes = self
            .store
            .get_opts(&path, GetOptions::default())
            .await?
            .bytes()
            .await?;
        LakeFile::decode(name, bytes).map_err(|source| LakeError::File {
            name: Box::new(name.clone()),
            source,
        })
    }

    /// Reads a day's sums; `None` if they are gone, or their bytes are not those of their name.
    ///
    /// # Errors
    /// The store cannot be read.
    pub async fn read_sums(&self, name: &SumsName) -> Result<Option<Bytes>, LakeError> {
        let path = self.path(&name.to_string())?;
        let bytes = match self.store.get_opts(&path, GetOptions::default()).await {
            Ok(found) => found.bytes().await?,
            // A compaction has made others.
            Err(StoreError::NotFound { .. }) => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        let whole = name.is_of(&bytes);
        if !whole {
            tracing::warn!("{name} was cut short or edited: it is not believed");
        }
        Ok(whole.then_some(bytes))
    }

    /// Reads parts of a file, as they are.
    ///
    /// # Errors
    /// They cannot be read.
    #[cfg(feature = "query")]
    pub(crate) async fn read_ranges(
        &self,
        name: &FileName,
        ranges: &[std::ops::Range<u64>],
    ) -> Result<Vec<Bytes>, LakeError> {
        let path = self.path(&name.to_string())?;
        Ok(self.store.get_ranges(&path, ranges).await?)
    }

    /// Removes an object; it is no error if it is gone already.
    ///
    /// # Errors
    /// The store refuses it.
    pub async fn remove(&self, name: &impl std::fmt::Display) -> Result<(), LakeError> {
        match self.store.delete(&self.path(&name.to_string())?).await {
            Ok(()) | Err(StoreError::NotFound { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

#[cfg(feature = "s3")]
fn s3(url: &str) -> Result<Lake, LakeError> {
    let open = || {
        let store = object_store::aws::AmazonS3Builder::from_env()
            .with_url(url)
            .build()?;
        let place = url.trim_start_matches("s3://");
        let (bucket, prefix) = place.split_once('/').unwrap_or((place, ""));
        let prefix = ObjectPath::parse(prefix)?;
        let address = Address {
            store: format!("s3://{bucket}/"),
            prefix: prefix.clone(),
        };
        let mut lake = Lake::in_store(Arc::new(store), prefix);
        lake.address = Some(address);
        Ok(lake)
    };
    open().map_err(|source| LakeError::Open {
        url: url.into(),
        source,
    })
}

#[cfg(not(feature = "s3"))]
fn s3(url: &str) -> Result<Lake, LakeError> {
    Err(LakeError::NoS3 { url: url.into() })
}
