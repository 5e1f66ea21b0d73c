//! The program `rockface`.

fn main() {
    std::process::exit(rockface::program::run(rockface_stages::registry()));
}
