// Runs the blocks of a launch on two threads of the system, in an order that no kernel may rely on.
//
// Blocks come in a scrambled order, the warps of a block too, and the lanes of a warp between any two collectives. A
// thread runs until it ends or waits for others; what spins until another thread of its block writes something never ends.
#include "device_launch.h"
#include "fibers.h"

#include <cstdarg>
#include <mutex>
#include <numeric>
#include <string>
#include <thread>

static constexpr int NUM_SYSTEM_THREADS = 2;

thread_local dim3 blockIdx { 0, 0, 0 }, threadIdx { 0, 0, 0 }, blockDim { 1, 1, 1 }, gridDim { 1, 1, 1 };

namespace {

std::mutex error_lock;
std::string error_message;  // of the first launch that failed since it was last taken
std::atomic<bool> has_failed { false };

// Numbers that look random, the same in each run that makes the same launches.
class Scrambler {
public:
    explicit Scrambler(uint64_t seed)
        : state_(seed * 0x9e3779b97f4a7c15u + 1)
    {
    }
    unsigned below(unsigned count)
    {
        state_ = state_ * 6364136223846793005u + 1442695040888963407u;
        return (unsigned)((state_ >> 33) % count);
    }
    template <class T> void shuffle(T* items, unsigned count)
    {
        for (unsigned k = count; k > 1; --k)
            std::swap(items[k - 1], items[below(k)]);
    }

private:
    uint64_t state_;
};

// A thread of the device that has begun.
struct DeviceThread {
    dim3 index { 0, 0, 0 };
    Fiber* fiber = nullptr;
    // what it waits for: a collective with a mask, or with none the whole block
    const char* waits_at = nullptr;
    unsigned mask = 0;
    bool is_ready = false, is_ended = false;
    uint64_t brought = 0;
    uint64_t seen[32];
};

// One thread of the system: the block that it runs.
class Processor {
public:
    void run_block(dim3 block, unsigned num_threads, DeviceFunction function, void* launch, Scrambler& scrambler)
    {
        current_ = this;
        blockIdx = block;
        threads_.resize(num_threads);
        for (unsigned k = 0; k < num_threads; ++k) {
            threads_[k].index = { k, 0, 0 };
            threads_[k].fiber = nullptr;
            threads_[k].waits_at = nullptr;
            threads_[k].is_ready = true;
            threads_[k].is_ended = false;
        }
        std::vector<unsigned> warps((num_threads + 31) / 32);
        std::iota(warps.begin(), warps.end(), 0u);
        bool is_over = false;
        while (!is_over && !has_failed) {
            scrambler.shuffle(warps.data(), (unsigned)warps.size());
            for (unsigned warp : warps)
                run_warp(32 * warp, std::min(32u, num_threads - 32 * warp), function, launch, scrambler);
            is_over = true;
            for (DeviceThread& thread : threads_)
                is_over = is_over && thread.is_ended;
            if (!is_over && !has_failed)
                open_barrier();
        }
        // after a failure: threads that have not ended are never resumed, and their stacks are used again
        for (DeviceThread& thread : threads_)
            if (thread.fiber)
                idle_.push_back(thread.fiber);
    }

    // Processors stay for the next launch, with their stacks.
    static std::unique_ptr<Processor> take()
    {
        std::lock_guard<std::mutex> guard(lock_);
        if (unused_.empty())
            return std::make_unique<Processor>();
        std::unique_ptr<Processor> processor = std::move(unused_.back());
        unused_.pop_back();
        return processor;
    }
    static void put_back(std::unique_ptr<Processor> processor)
    {
        std::lock_guard<std::mutex> guard(lock_);
        unused_.push_back(std::move(processor));
    }

    // --- called by a thread of the device ---

    const uint64_t* exchange(const char* name, unsigned mask, uint64_t value)
    {
        DeviceThread& self = *self_;
        if (!(mask >> (self.index.x % 32) & 1u))
            fail_launch("lane %u calls %s with mask %08x, which does not name it", self.index.x % 32, name, mask);
        self.brought = value;
        wait(name, mask);
        return self.seen;
    }

    void wait_for_block(const char* name) { wait(name, 0); }

    [[noreturn]] void leave() { self_->fiber->leave(); }
    const DeviceThread& self() const { return *self_; }
    static Processor& current() { return *current_; }

private:
    void wait(const char* name, unsigned mask)
    {
        DeviceThread& self = *self_;
        self.waits_at = name;
        self.mask = mask;
        self.is_ready = false;
        self.fiber->yield();
    }

    // Run the threads of a warp until each has ended or waits for the block.
    void run_warp(unsigned first, unsigned count, DeviceFunction function, void* launch, Scrambler& scrambler)
    {
        unsigned lanes[32];
        std::iota(lanes, lanes + count, first);
        for (bool is_any = true; is_any && !has_failed;) {
            is_any = false;
            scrambler.shuffle(lanes, count);
            for (unsigned k = 0; k < count && !has_failed; ++k) {
                DeviceThread& thread = threads_[lanes[k]];
                if (thread.is_ended || !thread.is_ready)
                    continue;
                is_any = true;
                run_thread(thread, function, launch);
                if (!thread.is_ended && thread.mask)
                    meet(first, count, thread);
            }
        }
        for (unsigned k = 0; k < count && !has_failed; ++k)
            if (const DeviceThread& thread = threads_[first + k]; !thread.is_ended && thread.mask)
                report_divergence(first, count, thread);
    }

    void run_thread(DeviceThread& thread, DeviceFunction function, void* launch)
    {
        self_ = &thread;
        threadIdx = thread.index;
        if (thread.fiber) {
            thread.fiber->resume();
        } else {
            if (idle_.empty()) {
                owned_.push_back(std::make_unique<Fiber>());
                idle_.push_back(owned_.back().get());
            }
            thread.fiber = idle_.back();
            idle_.pop_back();
            thread.fiber->start(function, launch);
        }
        if (!thread.fiber->is_running()) {
            thread.is_ended = true;
            idle_.push_back(thread.fiber);
            thread.fiber = nullptr;
        }
    }

    // Let the lanes go on that one waits for, if it was the last to arrive.
    void meet(unsigned first, unsigned count, DeviceThread& last)
    {
        for (unsigned k = 0; k < 32; ++k) {
            if (!(last.mask >> k & 1u))
                continue;
            if (k >= count)
                return;
            const DeviceThread& other = threads_[first + k];
            if (other.is_ended || other.is_ready || other.mask != last.mask || strcmp(other.waits_at, last.waits_at) != 0)
                return;
        }
        for (unsigned k = 0; k < 32; ++k) {
            if (!(last.mask >> k & 1u))
                continue;
            DeviceThread& reader = threads_[first + k];
            reader.is_ready = true;
            for (unsigned j = 0; j < 32; ++j)
                if (last.mask >> j & 1u)
                    reader.seen[j] = threads_[first + j].brought;
        }
    }

    void report_divergence(unsigned first, unsigned count, const DeviceThread& waiting)
    {
        for (unsigned k = 0; k < 32; ++k) {
            if (!(waiting.mask >> k & 1u))
                continue;
            const DeviceThread* other = k < count ? &threads_[first + k] : nullptr;
            const unsigned lane = waiting.index.x % 32;
            if (!other || other->is_ended)
                record_failure(
                    "divergence: lane %u of a warp waits at %s with mask %08x for lane %u, which has %s", lane,
                    waiting.waits_at, waiting.mask, k, other ? "ended" : "never begun"
                );
            else if (other->mask != waiting.mask || strcmp(other->waits_at, waiting.waits_at) != 0)
                record_failure(
                    "divergence: lane %u of a warp waits at %s with mask %08x for lane %u, which waits at %s with mask "
                    "%08x",
                    lane, waiting.waits_at, waiting.mask, k, other->waits_at, other->mask
                );
        }
    }

    // All that have not ended wait for the block: let them go on.
    void open_barrier()
    {
        for (DeviceThread& thread : threads_)
            thread.is_ready = true;
    }

public:
    static void record_failure(const char* format, ...)
    {
        va_list arguments;
        va_start(arguments, format);
        record_failure(format, arguments);
        va_end(arguments);
    }
    static void record_failure(const char* format, va_list arguments)
    {
        char text[512];
        vsnprintf(text, sizeof(text), format, arguments);
        std::lock_guard<std::mutex> guard(error_lock);
        if (!has_failed.exchange(true)) {
            error_message = text;
            fprintf(stderr, "emulated device: %s\n", text);
        }
    }

private:
    static inline thread_local Processor* current_ = nullptr;
    static inline std::mutex lock_;
    static inline std::vector<std::unique_ptr<Processor>> unused_;
    std::vector<DeviceThread> threads_;
    DeviceThread* self_ = nullptr;
    std::vector<std::unique_ptr<Fiber>> owned_;
    std::vector<Fiber*> idle_;
};

}  // namespace

const uint64_t* exchange(const char* name, unsigned mask, uint64_t value)
{
    return Processor::current().exchange(name, mask, value);
}

void wait_for_block(const char* name) { Processor::current().wait_for_block(name); }

void fail_launch(const char* format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    Processor::record_failure(format, arguments);
    va_end(arguments);
    Processor::current().leave();
}

int run_grid(size_t size, unsigned block_size, DeviceFunction function, void* launch)
{
    if (has_failed)
        return 1;
    static std::atomic<uint64_t> num_launches { 0 };
    const uint64_t seed = ++num_launches;
    const size_t num_blocks = size ? (size + block_size - 1) / block_size : 1;
    const size_t start = seed * 7919 % num_blocks;
    size_t stride = num_blocks < 3 ? 1 : num_blocks * 5 / 8 | 1;
    while (std::gcd(stride, num_blocks) != 1)
        ++stride;
    std::atomic<size_t> next { 0 };
    const auto work = [&](uint64_t which) {
        std::unique_ptr<Processor> processor = Processor::take();
        Scrambler scrambler(seed * NUM_SYSTEM_THREADS + which);
        blockDim = { block_size, 1, 1 };
        gridDim = { (unsigned)num_blocks, 1, 1 };
        for (size_t k; (k = next.fetch_add(1)) < num_blocks && !has_failed;) {
            const dim3 block { (unsigned)((start + k * stride) % num_blocks), 0, 0 };
            processor->run_block(block, block_size, function, launch, scrambler);
        }
        Processor::put_back(std::move(processor));
    };
    std::vector<std::thread> others;
    for (int k = 1; k < NUM_SYSTEM_THREADS && (size_t)k < num_blocks; ++k)
        others.emplace_back(work, k);
    work(0);
    for (std::thread& other : others)
        other.join();
    return has_failed;
}

const char* take_error()
{
    static thread_local std::string taken;
    std::lock_guard<std::mutex> guard(error_lock);
    taken.swap(error_message);
    error_message.clear();
    has_failed = false;
    return taken.c_str();
}
