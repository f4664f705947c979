//! The physics: motor, load, trajectory, thermal model, encoder.
