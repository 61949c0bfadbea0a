//! Integer quantities on the wire. The unit is the type's name; a bare number never crosses the link.

use serde::{Deserialize, Serialize};

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident($inner:ty), $symbol:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(transparent)]
        pub struct $name(pub $inner);

        impl $name {
            /// The bare count in the unit of the type's name.
            #[must_use]
            pub const fn get(self) -> $inner {
                self.0
            }
        }

        impl From<$name> for $inner {
            fn from(quantity: $name) -> Self {
                quantity.0
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                write!(f, concat!("{} ", $symbol), self.0)
            }
        }
    };
}

quantity!(
    /// Length or position, ±2147 m.
    Micrometres(i32),
    "um"
);
quantity!(
    /// Angle, ±2147 rad, counter-clockwise seen from +z.
    Microradians(i32),
    "urad"
);
quantity!(
    /// Speed of the vertical axis.
    MicrometresPerSecond(u32),
    "um/s"
);
quantity!(
    /// Acceleration of the vertical axis.
    MicrometresPerSecondSquared(u32),
    "um/s2"
);
quantity!(
    /// Speed of the rotary axis.
    MillidegreesPerSecond(u32),
    "mdeg/s"
);
quantity!(
    /// Acceleration of the rotary axis.
    MillidegreesPerSecondSquared(u32),
    "mdeg/s2"
);
quantity!(
    /// Duration, up to 71 minutes.
    Microseconds(u32),
    "us"
);
quantity!(
    /// Electrical current.
    Milliamps(u16),
    "mA"
);
quantity!(
    /// Counts of a liquid lens' driver: steps of its output voltage.
    LensCounts(u16),
    "counts"
);
quantity!(
    /// Time since the controller powered up, in microseconds of its own clock.
    Timestamp(u64),
    "us"
);

impl Microseconds {
    /// From whole milliseconds; saturates at the largest duration.
    #[must_use]
    pub const fn from_millis(millis: u32) -> Self {
        Self(millis.saturating_mul(1000))
    }
}

impl Timestamp {
    /// This time plus a duration; saturates instead of wrapping (584 000 years away).
    #[must_use]
    pub const fn after(self, duration: Microseconds) -> Self {
        Self(self.0.saturating_add(duration.0 as u64))
    }

    /// Time since `earlier`, zero when `earlier` is later.
    #[must_use]
    pub const fn since_us(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }
}
