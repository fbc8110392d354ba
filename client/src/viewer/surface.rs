//! What is to be done with a window's surface that gives no image? Pure, so that each case is tested without a screen.
//!
//! A surface may be lost, be out of date, be covered or have no size at all; each is met by making it anew or by drawing nothing for a
//! while. What does not get better by that ends the viewer with a message. Memory that is full is no state of a surface: the
//! device says so, and [`Gpu::check`](super::gpu::Gpu::check) passes it on.

use eyeline_visibility::Resolution;
use wgpu::CurrentSurfaceTexture as Current;

/// The size of images for a window of a size in physical pixels; `None` if there is nothing to draw on, as when it is minimised.
pub(super) fn drawable(width: u32, height: u32, most: u32) -> Option<Resolution> {
    (width > 0 && height > 0).then(|| Resolution::new(width.min(most), height.min(most)))
}

/// What a surface said when it was asked for an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Said {
    /// Here it is, and it fits.
    Image,
    /// Here it is, but the window has changed.
    Misfit,
    /// None, since the window has changed.
    Outdated,
    /// None in time.
    Timeout,
    /// None, since nobody would see it.
    Occluded,
    /// None, and never again.
    Lost,
    /// None, and the device has an error about it.
    Refused,
}

impl Said {
    pub(super) fn of(current: &Current) -> Said {
        match current {
            Current::Success(_) => Said::Image,
            Current::Suboptimal(_) => Said::Misfit,
            Current::Outdated => Said::Outdated,
            Current::Timeout => Said::Timeout,
            Current::Occluded => Said::Occluded,
            Current::Lost => Said::Lost,
            Current::Validation => Said::Refused,
        }
    }
}

/// What is to be done before a surface is asked again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Remedy {
    /// Nothing.
    None,
    /// Fit it to the window again.
    Fit,
    /// Try later.
    Wait { is_covered: bool },
    /// It is gone; another one of the same window may do.
    MakeAnew,
    /// Ask the device what is wrong.
    Ask,
    /// End, with this message.
    End(&'static str),
}

/// So many surfaces may be lost or refuse in a row. At 10 ms each that is a second, longer than a driver takes to come back.
const FAILURES_MAX: u32 = 100;

/// The failures in a row of a window's surfaces.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Failures(u32);

impl Failures {
    /// What to do about what a surface said.
    pub(super) fn remedy(&mut self, said: Said) -> Remedy {
        self.0 = if matches!(said, Said::Lost | Said::Refused) { self.0 + 1 } else { 0 };
        match said {
            Said::Lost if self.0 > FAILURES_MAX => Remedy::End("it is lost again and again; start the viewer again"),
            Said::Refused if self.0 > FAILURES_MAX => {
                Remedy::End("it gives no image and no reason; start the viewer again, or update the driver")
            }
            Said::Image => Remedy::None,
            Said::Misfit | Said::Outdated => Remedy::Fit,
            Said::Timeout => Remedy::Wait { is_covered: false },
            Said::Occluded => Remedy::Wait { is_covered: true },
            Said::Lost => Remedy::MakeAnew,
            Said::Refused => Remedy::Ask,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_without_pixels_is_not_drawn_on() {
        assert_eq!(drawable(0, 200, 100), None);
        assert_eq!(drawable(200, 0, 100), None);
        assert_eq!(drawable(1, 1, 100), Some(Resolution::new(1, 1)));
        assert_eq!(drawable(300, 80, 100), Some(Resolution::new(100, 80)));
    }

    #[test]
    fn whatever_a_surface_says_there_is_a_remedy() {
        let remedy = |current: Current| Failures::default().remedy(Said::of(&current));
        assert_eq!(remedy(Current::Outdated), Remedy::Fit);
        assert_eq!(remedy(Current::Timeout), Remedy::Wait { is_covered: false });
        assert_eq!(remedy(Current::Occluded), Remedy::Wait { is_covered: true });
        assert_eq!(remedy(Current::Lost), Remedy::MakeAnew);
        assert_eq!(remedy(Current::Validation), Remedy::Ask);
        assert_eq!(Failures::default().remedy(Said::Image), Remedy::None);
        assert_eq!(Failures::default().remedy(Said::Misfit), Remedy::Fit);
    }

    #[test]
    fn what_does_not_get_better_ends_with_a_message() {
        for said in [Said::Lost, Said::Refused] {
            let mut failures = Failures::default();
            for _ in 0..FAILURES_MAX {
                assert!(!matches!(failures.remedy(said), Remedy::End(_)), "{said:?}");
            }
            let Remedy::End(why) = failures.remedy(said) else { panic!("{said:?} goes on for ever") };
            assert!(why.contains("start the viewer again"), "{why}");
            // An image between two of them begins the count anew.
            failures.remedy(Said::Image);
            assert!(!matches!(failures.remedy(said), Remedy::End(_)), "{said:?}");
        }
        // Nobody looks: that may last.
        let mut failures = Failures::default();
        assert!((0..3 * FAILURES_MAX).all(|_| failures.remedy(Said::Occluded) == Remedy::Wait { is_covered: true }));
    }
}
