//! Wire contract between the host and the controller: units, messages, capture plan, framing.
