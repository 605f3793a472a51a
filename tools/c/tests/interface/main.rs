//! The library as C and C++ meet it: the header, and programs that are compiled, linked and run.
#![forbid(unsafe_code)]

mod header;
mod installed;
mod library;
mod programs;
mod street;
