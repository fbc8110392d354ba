//! The wire: its bytes spelled out, and what hostile ones can do.

mod golden;
mod hostile;
mod samples;
