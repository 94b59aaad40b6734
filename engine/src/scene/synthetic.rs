//! Scenes made by formula.
