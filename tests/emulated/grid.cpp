// The device: runs the blocks of a launch in an order that no kernel may rely on.
//
// Blocks come in a scrambled order, and some run at a time; their warps take turns, and so do the lanes of a warp between
// any two collectives, of which one may come long after the others. A thread runs until it ends or waits for others; what
// spins until another thread writes something never ends. Launches of several threads of the host run side by side.
#include "processor.h"

thread_local dim3 blockIdx { 0, 0, 0 }, threadIdx { 0, 0, 0 }, blockDim { 1, 1, 1 }, gridDim { 1, 1, 1 };

const uint64_t* exchange(const char* name, unsigned mask, uint64_t value)
{
    return Processor::current().exchange(name, mask, value);
}

void wait_for_block(const char* name) { Processor::current().wait_for_block(name); }

void fail_launch(const char* format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    Failure::record(format, arguments);
    va_end(arguments);
    throw ThreadEnded();
}

// Processors stay for the next launch, with their stacks.
class Processors {
public:
    std::unique_ptr<Processor> take()
    {
        std::lock_guard<std::mutex> guard(lock_);
        if (unused_.empty())
            return std::make_unique<Processor>(++num_made_);
        std::unique_ptr<Processor> processor = std::move(unused_.back());
        unused_.pop_back();
        return processor;
    }
    void put_back(std::unique_ptr<Processor> processor)
    {
        std::lock_guard<std::mutex> guard(lock_);
        unused_.push_back(std::move(processor));
    }

private:
    std::mutex lock_;
    std::vector<std::unique_ptr<Processor>> unused_;
    uint64_t num_made_ = 0;
};

int run_grid(size_t size, unsigned block_size, Togetherness togetherness, DeviceFunction function, void* argument)
{
    static Processors processors;
    static std::atomic<uint64_t> num_launches { 0 };
    Scrambler scrambler(++num_launches);
    const size_t num_blocks = size ? (size + block_size - 1) / block_size : 1;
    std::unique_ptr<Processor> processor = processors.take();
    blockDim = { block_size, 1, 1 };
    gridDim = { (unsigned)num_blocks, 1, 1 };
    processor->run(ScrambledRange(num_blocks, scrambler), num_blocks, block_size, { function, argument, togetherness });
    processors.put_back(std::move(processor));
    return Failure::is_set();
}

const char* take_error()
{
    static thread_local std::string taken;
    taken = Failure::take();
    return taken.c_str();
}

// --- what the compiler calls before an access to memory, with the option for ThreadSanitizer ---

// Reads are not looked at: they are most of the accesses, and who reads too early mostly gets another answer.
#define ON_ACCESS(size)                                                                                                \
    extern "C" void __tsan_read##size(void*) { }                                                                       \
    extern "C" void __tsan_write##size(void* place)                                                                    \
    {                                                                                                                  \
        if (Races* races = Processor::races())                                                                         \
            races->write(place, size);                                                                                 \
    }
ON_ACCESS(1)
ON_ACCESS(2)
ON_ACCESS(4)
ON_ACCESS(8)
ON_ACCESS(16)
#undef ON_ACCESS
extern "C" void __tsan_unaligned_read2(void*) { }
extern "C" void __tsan_unaligned_read4(void*) { }
extern "C" void __tsan_unaligned_read8(void*) { }
extern "C" void __tsan_unaligned_read16(void*) { }
extern "C" void __tsan_unaligned_write2(void* place) { __tsan_write2(place); }
extern "C" void __tsan_unaligned_write4(void* place) { __tsan_write4(place); }
extern "C" void __tsan_unaligned_write8(void* place) { __tsan_write8(place); }
extern "C" void __tsan_unaligned_write16(void* place) { __tsan_write16(place); }
extern "C" void __tsan_read_range(void*, size_t) { }
extern "C" void __tsan_write_range(void* place, size_t size)
{
    if (Races* races = Processor::races())
        races->write(place, size);
}
extern "C" void __tsan_init() { }
extern "C" void __tsan_vptr_update(void**, void*) { }
extern "C" void __tsan_vptr_read(void**) { }

#define ON_ATOMIC(bits)                                                                                                \
    extern "C" uint##bits##_t __tsan_atomic##bits##_load(const volatile void* place, int)                              \
    {                                                                                                                  \
        return __atomic_load_n((const volatile uint##bits##_t*)place, __ATOMIC_RELAXED);                               \
    }                                                                                                                  \
    extern "C" bool __tsan_atomic##bits##_compare_exchange_strong(                                                     \
        volatile void* place, void* expected, uint##bits##_t value, int, int                                           \
    )                                                                                                                  \
    {                                                                                                                  \
        if (Races* races = Processor::races())                                                                         \
            races->write_atomically((const void*)place);                                                               \
        return __atomic_compare_exchange_n(                                                                            \
            (volatile uint##bits##_t*)place, (uint##bits##_t*)expected, value, false, __ATOMIC_RELAXED, __ATOMIC_RELAXED  \
        );                                                                                                             \
    }                                                                                                                  \
    extern "C" bool __tsan_atomic##bits##_compare_exchange_weak(                                                       \
        volatile void* place, void* expected, uint##bits##_t value, int success, int failure                           \
    )                                                                                                                  \
    {                                                                                                                  \
        return __tsan_atomic##bits##_compare_exchange_strong(place, expected, value, success, failure);                \
    }
ON_ATOMIC(8)
ON_ATOMIC(16)
ON_ATOMIC(32)
ON_ATOMIC(64)
#undef ON_ATOMIC
extern "C" void __tsan_atomic_thread_fence(int) { }
