//! Board-free controller: capture sequence, drivers over embedded-hal traits, thin embassy tasks.
