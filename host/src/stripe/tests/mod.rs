//! Tests against recordings with truth and against a renderer of their own.

mod recordings;
