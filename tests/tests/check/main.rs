//! Checks end to end: from an order on the command line to a verdict and its uncertainty.

mod adaptive;
mod both_signs;
mod compare;
mod damage;
mod datum;
mod die_mesh;
mod examples;
mod features;
mod fine_structure;
mod heads;
mod in_view;
mod inspect;
mod lens;
mod remeasure;
mod scoring;
mod unmodelled;
mod wear_of_cloud;
