//! The running sums of a view, pass by pass.

use flankscope_profilometry::{Accumulator, Decoder, FrameError, FrameKind, FrameLevel, FrameView};

/// Role of one frame within a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedFrame {
    /// Its pass, from 0; the dark frame belongs to all passes.
    pub pass: usize,
    /// Kind of frame: dark, fringe or code.
    pub kind: FrameKind,
    /// Mean level that a dark frame stays below and a lit one exceeds, DN.
    pub dark_limit_dn: f64,
}

/// The frames of a view in the order of their triggers: the dark frame, then for each exposure all passes one after the other.
/// `lit_ratios` are the fractions of the light of all mirrors that the passes give; empty: one pass of all mirrors.
pub fn planned_frames(decoder: &Decoder, lit_ratios: &[f64]) -> Vec<PlannedFrame> {
    let plain = decoder.dark_limit_dn();
    let offset_dn = decoder.sensor().offset_dn;
    let lit_ratios = if lit_ratios.is_empty() {
        &[1.0]
    } else {
        lit_ratios
    };
    let mut frames = Vec::new();
    let order: Vec<FrameKind> = decoder.capture_order().collect();
    for of_exposure in order.chunk_by(|a, b| a.exposure() == b.exposure()) {
        let is_dark = of_exposure.contains(&FrameKind::Dark);
        let passes = lit_ratios.iter().enumerate();
        for (pass, lit_ratio) in passes.take(if is_dark { 1 } else { lit_ratios.len() }) {
            let dark_limit_dn = match is_dark {
                true => plain,
                // A pass lights less of the field, so its mean level is lower.
                false => offset_dn + lit_ratio * (plain - offset_dn),
            };
            frames.extend(of_exposure.iter().map(|&kind| PlannedFrame {
                pass,
                kind,
                dark_limit_dn,
            }));
        }
    }
    frames
}

/// The running sums of a view.
#[derive(Clone, Debug)]
pub struct ViewSums {
    first: Accumulator,
    /// Sums of later passes, or of a second projector.
    others: Vec<Accumulator>,
}

impl ViewSums {
    /// Empty ones.
    pub fn new(decoder: &Decoder, passes: usize) -> Self {
        let mut first = decoder.begin();
        // A second projector shows its patterns as a second pass.
        let others = match first.take_second() {
            Some(second) => vec![second],
            None => (1..passes).map(|_| decoder.begin()).collect(),
        };
        Self { first, others }
    }

    /// Clears the sums for the next view.
    pub fn reset(&mut self) {
        self.others.extend(self.first.take_second());
        self.passes().for_each(Accumulator::reset);
    }

    /// Adds a frame to the sums of its pass.
    ///
    /// # Errors
    /// The frame has another size, comes in another order, or is dark or lit where it should not be.
    pub fn add(&mut self, frame: FrameView<'_>, planned: PlannedFrame) -> Result<(), FrameError> {
        let PlannedFrame {
            pass,
            kind,
            dark_limit_dn,
        } = planned;
        let check = |level: FrameLevel| level.check_content(kind, dark_limit_dn);
        let is_dark = kind == FrameKind::Dark;
        self.passes()
            .enumerate()
            .filter(|(at, _)| is_dark || *at == pass)
            .try_for_each(|(_, sums)| sums.add(frame, kind).and_then(check))
    }

    fn passes(&mut self) -> impl Iterator<Item = &mut Accumulator> {
        std::iter::once(&mut self.first).chain(&mut self.others)
    }

    /// The sums of the view. If a pass is incomplete, empty ones, which no decoder accepts as a view.
    pub fn joined(&mut self, decoder: &Decoder) -> &Accumulator {
        if decoder.projectors() > 1
            && let Some(second) = self.others.pop()
        {
            self.first.put_second(second);
        } else if !self.others.is_empty()
            && let Err(error) = decoder.join_passes(&mut self.first, &self.others)
        {
            tracing::error!(%error, "passes of a view");
            self.first.reset();
        }
        &self.first
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use flankscope_profilometry::{DecodeOptions, HeadModel, PatternSet};
    use flankscope_test_requisites::DRAWN_HEAD;

    const VOLUME_AND_SENSOR: &str = r#"
        [volume]
        near_mm = 19.0
        far_mm = 24.0
        [sensor]
        bits = 12
        full_well_e = 32400.0
        gain_e_per_dn = 7.91
        read_noise_e = 7.0
        offset_dn = 100.0
    "#;

    /// Of a drawn head with `high12` at two exposures.
    pub fn decoder() -> Decoder {
        let head: HeadModel = toml::from_str(&format!("{DRAWN_HEAD}{VOLUME_AND_SENSOR}")).unwrap();
        let set = PatternSet::named("high12").unwrap();
        let options = DecodeOptions::for_head(&head);
        Decoder::new(&head, &set, &[10_000, 20_000], options).unwrap()
    }

    #[test]
    fn frames_follow_each_other_as_the_plan_shows_them() {
        let set = PatternSet::named("high12").unwrap();
        let decoder = decoder();
        let lit_ratios = [0.5, 0.25, 1.0];
        let frames = planned_frames(&decoder, &lit_ratios);
        assert_eq!(frames.len(), 1 + 2 * 3 * 12);
        // The controller's own frame order for the same plan.
        let order = flankscope_protocol::plan::FrameOrder {
            exposures: 2,
            patterns: 36,
        };
        let pictures: Vec<_> = set.pictures().collect();
        let offset_dn = decoder.sensor().offset_dn;
        let span_dn = decoder.dark_limit_dn() - offset_dn;
        for (index, frame) in frames.iter().enumerate() {
            let place = order.place(index as u16).unwrap();
            let Some(shown) = place.pattern.checked_sub(1).map(usize::from) else {
                assert_eq!((frame.pass, frame.kind), (0, FrameKind::Dark));
                assert_eq!(frame.dark_limit_dn, decoder.dark_limit_dn());
                continue;
            };
            assert_eq!(frame.pass, shown / 12);
            let exposure = usize::from(place.exposure);
            assert_eq!(
                frame.kind,
                FrameKind::from_picture(pictures[shown % 12], exposure)
            );
            let limit_dn = offset_dn + lit_ratios[frame.pass] * span_dn;
            assert_eq!(frame.dark_limit_dn, limit_dn);
        }
        let plain = planned_frames(&decoder, &[]);
        let kinds: Vec<FrameKind> = plain.iter().map(|frame| frame.kind).collect();
        assert_eq!(kinds, decoder.capture_order().collect::<Vec<_>>());
        assert!(plain.iter().all(|frame| frame.pass == 0));
    }
}
