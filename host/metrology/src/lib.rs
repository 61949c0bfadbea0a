//! Points against CAD: meshes, registration, exact deviation, wear, verdict.
