//! Converts failures of frames, controller and camera to reasons of a verdict.

use flankscope_metrology::verdict::{Code, Reason};
use flankscope_profilometry::head::Unfit;

use flankscope_instrument::acquisition::{
    AcquisitionError, ImageProblem, PairingError, Stop, ViewError,
};
use flankscope_instrument::controller::ClientError;

/// Why a view could not be measured.
pub(crate) fn view_lost(error: &ViewError) -> Reason {
    let code = match error {
        ViewError::Frame(_) => Code::FrameContent,
        ViewError::Receive(_) | ViewError::Image(ImageProblem::Image(_)) => Code::FrameUnreadable,
        ViewError::Image(_) => Code::FrameContent,
        ViewError::NotRecorded { .. } | ViewError::Pose(_) => Code::NotCaptured,
        ViewError::Pairing(PairingError::Count { .. } | PairingError::Counter { .. })
        | ViewError::Incomplete { .. } => Code::FramesMissing,
        ViewError::Pairing(
            PairingError::Pattern { .. }
            | PairingError::Exposure { .. }
            | PairingError::Interval { .. },
        ) => Code::TriggerMismatch,
        ViewError::Pairing(PairingError::Stalled { .. }) => Code::Stalled,
        ViewError::Session { .. } | ViewError::BeyondPlan => Code::FrameForeign,
    };
    Reason::instrument(code, error)
}

/// Why a check was stopped.
pub(crate) fn stopped(stop: &Stop) -> Reason {
    let code = match stop {
        Stop::Fault(_) => Code::ControllerFault,
        Stop::EventsLost { .. } => Code::EventsLost,
        Stop::Broken(AcquisitionError::Client(
            ClientError::EventsMissing { .. } | ClientError::EventRepeated { .. },
        )) => Code::EventsLost,
        Stop::Broken(AcquisitionError::Client(_)) => Code::LinkLost,
        Stop::Broken(AcquisitionError::Faulted { .. } | AcquisitionError::OtherStage { .. }) => {
            Code::ControllerFault
        }
        Stop::Interrupted | Stop::Broken(AcquisitionError::Interrupted) => Code::Interrupted,
        Stop::Broken(_) | Stop::Stalled => Code::CaptureStalled,
        Stop::Camera(_) => Code::CameraUnusable,
        Stop::HoldLimit => Code::HoldTime,
    };
    Reason::instrument(code, stop)
}

/// Why a head must not judge.
pub(crate) fn unfit(why: &Unfit) -> Reason {
    Reason::instrument(Code::HeadUnfit, why)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_protocol::{Fault, FaultCode};

    #[test]
    fn what_went_wrong_keeps_its_words_and_gets_a_kind() {
        let late = ViewError::from(PairingError::Interval {
            frame: 3,
            got_us: 9,
            fired_us: 5,
        });
        let link = Stop::Broken(ClientError::NoEvent { timeout_ms: 15_000 }.into());
        let fault = Stop::Fault(FaultCode::from(Fault::ALL[0]));
        for (reason, sentence, code) in [
            (view_lost(&late), late.to_string(), Code::TriggerMismatch),
            (stopped(&link), link.to_string(), Code::LinkLost),
            (stopped(&fault), fault.to_string(), Code::ControllerFault),
        ] {
            assert_eq!((reason.to_string(), reason.code()), (sentence, code));
        }
        let short = ViewError::Incomplete {
            got: 3,
            planned: 25,
        };
        assert_eq!(view_lost(&short).code(), Code::FramesMissing);
        assert_eq!(view_lost(&ViewError::BeyondPlan).code(), Code::FrameForeign);
    }
}
