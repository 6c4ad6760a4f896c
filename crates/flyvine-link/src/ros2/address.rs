//! Which ROS 2 network is meant.

use std::net::{IpAddr, Ipv4Addr};
use std::str::FromStr;

use rustdds::{DomainParticipant, DomainParticipantBuilder};

use super::RosError;

/// The highest domain for which DDS has ports.
const DOMAIN_MAX: u16 = 232;

/// A domain (`ROS_DOMAIN_ID`) in one network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RosAddress {
    /// The domain.
    pub domain: u16,
    /// This machine's address in the network; loopback unless asked otherwise.
    pub interface: IpAddr,
}

impl FromStr for RosAddress {
    type Err = RosError;

    /// Reads `DOMAIN` or `DOMAIN@ADDRESS`.
    fn from_str(text: &str) -> Result<Self, RosError> {
        let error = || RosError::Address {
            address: text.to_owned(),
        };
        let (domain, interface) = match text.split_once('@') {
            Some((domain, address)) => (domain, address.parse().map_err(|_| error())?),
            None => (text, IpAddr::V4(Ipv4Addr::LOCALHOST)),
        };
        let domain = domain.parse().ok().filter(|domain| *domain <= DOMAIN_MAX);
        Ok(RosAddress {
            domain: domain.ok_or_else(error)?,
            interface,
        })
    }
}

impl std::fmt::Display for RosAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}@{}", self.domain, self.interface)
    }
}

impl RosAddress {
    /// Joins the domain.
    pub(super) fn join(&self) -> Result<DomainParticipant, RosError> {
        Ok(DomainParticipantBuilder::new(self.domain)
            .with_only_networks([self.interface])
            .build()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loopback_unless_asked_otherwise() {
        let address: RosAddress = "42".parse().unwrap();
        assert!(address.domain == 42 && address.interface.is_loopback());
        assert_eq!(address.to_string().parse::<RosAddress>().unwrap(), address);
        let address: RosAddress = "0@192.168.1.7".parse().unwrap();
        assert!(address.domain == 0 && !address.interface.is_loopback());
        for nonsense in ["", "-1", "233", "0@", "0@lab", "a"] {
            assert!(nonsense.parse::<RosAddress>().is_err(), "{nonsense}");
        }
    }
}
