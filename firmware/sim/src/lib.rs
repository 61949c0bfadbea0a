//! The controller on the host: embassy executor, one time driver, virtual pins and UARTs.
