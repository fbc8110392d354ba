//! From when until when is a certificate good? TLS does not ask its owner's side: a server with a certificate that ended
//! serves it, and only its clients complain.

use std::path::Path;
use std::time::Duration;

use eyeline_protocol::WorldTime;
use rustls::pki_types::CertificateDer;

use crate::token::calendar;

/// Who has so little time left for a new certificate is told.
pub const RENEW_WITHIN: Duration = Duration::from_secs(14 * 86_400);

/// What is to be said about a certificate's time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Complaint {
    /// Whether clients that check it will not come in now; else it will come to that.
    pub is_now: bool,
    /// The file, the dates and the remedy.
    pub text: String,
}

/// When a certificate is good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Dates {
    from: WorldTime,
    until: WorldTime,
}

impl Dates {
    fn of(certificate: &CertificateDer<'_>) -> Option<Dates> {
        let (_, certificate) = x509_parser::parse_x509_certificate(certificate).ok()?;
        let at = |seconds: i64| WorldTime::from_micros(seconds.saturating_mul(1_000_000));
        let validity = certificate.validity();
        Some(Dates { from: at(validity.not_before.timestamp()), until: at(validity.not_after.timestamp()) })
    }

    /// What is to be said about `whose` time at `now`, if anything.
    fn complaint(self, whose: &str, now: WorldTime) -> Option<Complaint> {
        let (from, until) = (calendar(self.from), calendar(self.until));
        let dates = format!("it is good from {from} until {until}");
        if now < self.from {
            let remedy = "wait until then, or put the right one in its place; is a clock wrong?";
            return Some(Complaint { is_now: true, text: format!("{whose} has not begun: {dates}; {remedy}") });
        }
        if now > self.until {
            let remedy = "have a new one made and put it in its place";
            return Some(Complaint { is_now: true, text: format!("{whose} has ended: {dates}; {remedy}") });
        }
        let days = self.until.since(now).as_secs() / 86_400;
        (self.until.since(now) < RENEW_WITHIN).then(|| {
            let remedy = "have a new one made and put it in its place; a running server reads it again";
            Complaint { is_now: false, text: format!("{whose} ends in {days} days: {dates}; {remedy}") }
        })
    }
}

/// What is to be said at `now` about the time of the certificates in `file`, the server's own first.
pub(super) fn complaints(file: &Path, chain: &[CertificateDer<'_>], now: WorldTime) -> Vec<Complaint> {
    let complaint = |(index, certificate): (usize, &CertificateDer<'_>)| {
        let whose = match index {
            0 => format!("{}: the certificate", file.display()),
            _ => format!("{}: certificate {} of {}", file.display(), index + 1, chain.len()),
        };
        match Dates::of(certificate) {
            Some(dates) => dates.complaint(&whose, now),
            None => Some(Complaint {
                is_now: false,
                text: format!("{whose} says in no known way until when it is good; have another one made"),
            }),
        }
    };
    chain.iter().enumerate().filter_map(complaint).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::token::from_calendar;

    fn made(from: &str, until: &str) -> CertificateDer<'static> {
        let day = |text: &str| {
            let mut parts = text.split('-').map(|part| part.parse::<i32>().unwrap());
            let mut next = || parts.next().unwrap();
            rcgen::date_time_ymd(next(), next() as u8, next() as u8)
        };
        let mut params = rcgen::CertificateParams::new(vec!["eyeline".to_owned()]).unwrap();
        (params.not_before, params.not_after) = (day(from), day(until));
        params.self_signed(&rcgen::KeyPair::generate().unwrap()).unwrap().der().clone()
    }

    #[test]
    fn a_certificate_that_has_ended_or_not_begun_or_soon_ends_is_told_of_with_its_file_and_dates() {
        let own = made("2026-01-01", "2026-04-01");
        let between = made("2020-01-01", "2030-01-01");
        let chain = [own, between];
        let at = |day: &str| {
            let now = from_calendar(&format!("{day}T12:00:00Z")).unwrap();
            complaints(Path::new("tls/a.pem"), &chain, now)
        };
        assert_eq!(at("2026-02-01"), []);
        assert_eq!(at("2026-03-17"), [], "more than 14 days are left");
        for (day, is_now, said) in [
            ("2025-12-31", true, "tls/a.pem: the certificate has not begun"),
            ("2026-03-20", false, "tls/a.pem: the certificate ends in 11 days"),
            ("2026-03-31", false, "tls/a.pem: the certificate ends in 0 days"),
            ("2026-04-01", true, "tls/a.pem: the certificate has ended"),
        ] {
            let said_all = at(day);
            assert_eq!(said_all.len(), 1, "{said_all:?}");
            assert_eq!(said_all[0].is_now, is_now, "{said_all:?}");
            assert!(said_all[0].text.starts_with(said), "{said_all:?}");
            assert!(said_all[0].text.contains("from 2026-01-01T00:00:00Z until 2026-04-01T00:00:00Z"), "{said_all:?}");
        }
        // The authority in between has a time of its own.
        let texts: Vec<String> = at("2031-01-01").into_iter().map(|complaint| complaint.text).collect();
        assert!(texts.len() == 2 && texts[1].contains("certificate 2 of 2 has ended"), "{texts:?}");
        let odd = complaints(Path::new("a.pem"), &[CertificateDer::from(vec![1, 2, 3])], WorldTime::ZERO);
        assert!(odd[0].text.contains("no known way") && !odd[0].is_now, "{odd:?}");
    }
}
