//! The plane at the entry, the needle's angle and path (paper, Section 2.4; Eq. 12–19).
