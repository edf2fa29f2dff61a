//! The puncture: which angle, by simulation that can be checked (paper, Sections 2.5 and 3.4).

pub mod cohesive;
pub mod contact;
pub mod decision;
pub mod element;
pub mod events;
pub mod explicit;
pub mod lane;
pub mod material;
pub mod mesh;
pub mod needle;
pub mod output;
pub mod pressure;
pub mod run;
pub mod tissue;
