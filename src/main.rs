//! The program `rockface`.

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() {
    rockface::memory::keep_freed();
    std::process::exit(rockface::program::run(rockface_stages::registry()));
}
