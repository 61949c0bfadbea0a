//! Core maps as files, and sums core by core, against plain loops.

mod bench_scene;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use bench_scene::{HEIGHT, Light, WIDTH, accumulate, capture, columns, head, plane};
use flankscope_profilometry::date::Date;
use flankscope_profilometry::decode::MaskOptions;
use flankscope_profilometry::decode::{DecodeError, GridKind};
use flankscope_profilometry::head::{CoreMap, CoreMapError};
use flankscope_profilometry::{DecodeOptions, Decoder, FrameKind, HeadModel, PatternSet};

/// A hexagonal lattice of 4 px pitch over the small test camera, with one core at the very edge.
fn map() -> CoreMap {
    let mut positions_px = vec![[0.4, 50.0]];
    for row in 0..24 {
        for column in 0..34 {
            let shift = if row % 2 == 0 { 0.0 } else { 2.0 };
            positions_px.push([
                6.0 + 4.0 * f64::from(column) + shift,
                6.3 + 3.4641 * f64::from(row),
            ]);
        }
    }
    CoreMap {
        width_px: WIDTH as u32,
        height_px: HEIGHT as u32,
        core_sigma_px: 1.0,
        gains: vec![1.0; positions_px.len()],
        positions_px,
    }
}

fn with_map() -> HeadModel {
    HeadModel {
        core_map: Some(Arc::new(map())),
        ..head()
    }
}

#[test]
fn a_core_sums_the_nine_pixels_about_it() {
    let head = with_map();
    let patterns = PatternSet::named("insitu12").unwrap();
    let decoder = Decoder::new(&head, &patterns, &[1000], DecodeOptions::for_head(&head)).unwrap();
    let light = Light {
        mean_e: 9000.0,
        contrast: 0.6,
        noise_seed: Some(5),
    };
    let columns = columns(&head, plane([0.1, 0.05, 1.0], 22.0));
    let frames = capture(&head, &decoder, &patterns, &columns, &[1.0], &light);
    let accumulator = accumulate(&decoder, &frames);
    let mut boxes: Vec<(usize, usize)> = map()
        .positions_px
        .iter()
        .filter(|at| at[0] >= 0.5)
        .map(|at| (at[1].round() as usize - 1, at[0].round() as usize - 1))
        .filter(|&(top, left)| top + 3 <= HEIGHT && left + 3 <= WIDTH)
        .collect();
    boxes.sort_unstable();
    assert_eq!(decoder.grid().len(), boxes.len());
    for (cell, &(top, left)) in boxes.iter().enumerate() {
        let mut sums = [0.0; 2];
        for (kind, pixels) in &frames {
            if let FrameKind::Fringe { set, .. } = kind {
                for y in top..top + 3 {
                    for x in left..left + 3 {
                        sums[*set] += f64::from(pixels[y * WIDTH + x]);
                    }
                }
            }
        }
        for (set, expected) in sums.into_iter().enumerate() {
            let got = f64::from(accumulator.phasor(set, cell).unwrap().sum);
            // Single precision over eight frames.
            assert!((got / expected - 1.0).abs() < 1e-6, "{got} not {expected}");
        }
    }
}

#[test]
fn maps_survive_their_file_and_strangers_are_refused() {
    let folder = std::env::temp_dir().join(format!("flankscope-cores-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("head.toml");
    let today = "2026-03-01".parse::<Date>().unwrap();
    let (csv, reference) = map().to_csv(Path::new("cores.csv"), today);
    let write = |csv: &str, change: &dyn Fn(&mut HeadModel)| {
        std::fs::write(folder.join("cores.csv"), csv).unwrap();
        let mut described = head();
        described.cores = Some(reference.clone());
        change(&mut described);
        std::fs::write(&path, described.to_toml().unwrap()).unwrap();
        HeadModel::load(&path)
    };
    let rehash = |csv: &str| {
        let blake3 = blake3::hash(csv.as_bytes()).to_hex().to_string();
        move |head: &mut HeadModel| {
            if let Some(cores) = &mut head.cores {
                cores.blake3.clone_from(&blake3);
            }
        }
    };

    let read = write(&csv, &|_| {}).unwrap().core_map.unwrap();
    assert_eq!(read.gains, map().gains);
    for (read, written) in read.positions_px.iter().zip(map().positions_px) {
        assert!((read[0] - written[0]).abs() < 6e-5 && (read[1] - written[1]).abs() < 6e-5);
    }

    let other = csv.replace("6.3000", "6.4000");
    assert!(matches!(
        write(&other, &|_| {}),
        Err(CoreMapError::Hash { .. })
    ));
    for (line, changed) in [
        (1, csv.replace("gain", "brightness")),
        (3, csv.replacen("6.0000,6.3000", "6.0000,nan", 1)),
        (3, csv.replacen("6.0000,6.3000", "6.0000,960.0", 1)),
        (3, csv.replacen("6.0000,6.3000,1.0000", "6.0000,6.3000", 1)),
    ] {
        let error = write(&changed, &rehash(&changed)).unwrap_err();
        assert!(
            error.to_string().contains(&format!("cores.csv:{line}:")),
            "{error}"
        );
    }
    let error = write(&csv, &|head| {
        if let Some(cores) = &mut head.cores {
            cores.unit = "mm".to_owned();
        }
    });
    assert!(error.unwrap_err().to_string().contains("cores.unit"));
    let gone = write(&csv, &|head| {
        if let Some(cores) = &mut head.cores {
            cores.file = PathBuf::from("nowhere.csv");
        }
    });
    assert!(matches!(gone, Err(CoreMapError::File(_))));
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn what_cannot_be_decoded_core_by_core_is_refused() {
    let patterns = PatternSet::named("insitu12").unwrap();
    let refused = |head: &HeadModel, options: DecodeOptions| {
        Decoder::new(head, &patterns, &[1000], options).unwrap_err()
    };
    let on_cores = DecodeOptions {
        grid: GridKind::Core,
        ..DecodeOptions::for_head(&head())
    };
    assert_eq!(refused(&head(), on_cores.clone()), DecodeError::NoCores);
    let smooth = DecodeOptions {
        smoothing_px: 0.7,
        ..on_cores
    };
    assert!(matches!(
        refused(&with_map(), smooth),
        DecodeError::Option {
            option: "smoothing_px",
            ..
        }
    ));
}

/// Light on the left half, a twentieth of it on the right: the mask finds the edge, wherever a core's light falls.
#[test]
fn the_mask_works_on_cores_too() {
    let head = with_map();
    let patterns = PatternSet::named("insitu12").unwrap();
    let light = Light {
        mean_e: 9000.0,
        contrast: 0.6,
        noise_seed: None,
    };
    let columns = columns(&head, plane([0.0, 0.0, 1.0], 22.0));
    let run = |dim: u16, threshold_dn: f64, smoothing_px: f64| {
        let options = DecodeOptions {
            min_contrast: 0.0,
            patches: None,
            mask: Some(MaskOptions {
                threshold_dn,
                smoothing_px,
            }),
            ..DecodeOptions::for_head(&head)
        };
        let decoder = Decoder::new(&head, &patterns, &[1000], options).unwrap();
        let mut frames = capture(&head, &decoder, &patterns, &columns, &[1.0], &light);
        for (_, pixels) in &mut frames {
            for row in pixels.chunks_exact_mut(WIDTH) {
                row[WIDTH / 2..]
                    .iter_mut()
                    .for_each(|pixel| *pixel = 100 + (*pixel - 100) / dim);
            }
        }
        decoder.finish(&accumulate(&decoder, &frames)).unwrap()
    };
    let side = |cloud: &flankscope_profilometry::Cloud, left: bool, margin: usize| -> Vec<f32> {
        let there = |cell: &[u16; 2]| {
            let x = usize::from(cell[0]);
            if left {
                x + margin < WIDTH / 2
            } else {
                x > WIDTH / 2 + margin
            }
        };
        let both = cloud.cell.iter().zip(&cloud.fringes_dn);
        both.filter(|(cell, _)| there(cell))
            .map(|(_, &dn)| dn)
            .collect()
    };
    let (bright, sharp) = (run(1, 0.0, 0.0).cloud, run(20, 0.0, 0.0).cloud);
    assert_eq!(sharp.fringes_dn.len(), sharp.len());
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    // A box that reaches over the edge belongs to neither side; integer counts round the dim one.
    assert_eq!(side(&bright, true, 3), side(&sharp, true, 3));
    let ratio = mean(&side(&bright, false, 3)) / mean(&side(&sharp, false, 3));
    assert!((ratio / 20.0 - 1.0).abs() < 0.02, "{ratio}");
    // Beyond four sigma of the Gaussian nothing of the other side is left: above 1000 counts there, below 60 here.
    let smoothing_px = 6.0;
    let margin = (4.0 * smoothing_px) as usize;
    let masked = run(20, 300.0, smoothing_px);
    let kept = |left| side(&masked.cloud, left, margin).len();
    assert_eq!(kept(true), side(&sharp, true, margin).len());
    assert!(kept(true) > 0 && kept(false) == 0);
    assert!(masked.rejected.masked > 0);
}
