// Where the blocks of a launch run: on one thread of the system, some of them at the same time.
#pragma once

#include "device_launch.h"
#include "failure.h"
#include "fibers.h"
#include "races.h"
#include "scrambler.h"

#include <pthread.h>

#include <algorithm>
#include <memory>
#include <vector>

// What the threads of a launch run.
struct Launch {
    DeviceFunction function;
    void* argument;
    Togetherness togetherness;

    // Run a thread to its end; a failure ends it early.
    void call() const
    {
        try {
            function(argument);
        } catch (const ThreadEnded&) {
        }
    }
    static void call_on_fiber(void* launch) { ((const Launch*)launch)->call(); }
};

// A thread of the device.
struct DeviceThread {
    Fiber* fiber = nullptr;  // while it has begun and not ended
    bool is_ready = true, is_ended = false;
    // what it waits for: a collective of the lanes of a mask, or with no mask the whole block
    const char* waits_at = nullptr;
    unsigned mask = 0;
    uint64_t brought = 0;  // to the collective
    uint64_t seen[32];  // what the lanes have brought
    uint32_t at_warp = 0, at_block = 0;  // collectives that it has been through
};

// A warp whose block is on the processor.
struct Warp {
    unsigned block = 0, first = 0, count = 0;  // threads of its block
    DeviceThread* lanes = nullptr;
    // A lane that is held up where the others go on, and how many turns of warps it waits once they need it.
    unsigned late_lane = 0;
    uint64_t patience = 0;
    bool is_over = false;
};

// Threads whose blocks are on a processor at the same time: two blocks of a warp, whose stacks stay in the cache.
static constexpr unsigned MOST_THREADS = 64;

// The stack of the host's thread that launches, on which threads run that never wait for another.
struct SystemStack {
    void* begin = nullptr;
    size_t num_bytes = 0;

    SystemStack()
    {
        pthread_attr_t attributes;
        if (pthread_getattr_np(pthread_self(), &attributes) == 0) {
            pthread_attr_getstack(&attributes, &begin, &num_bytes);
            pthread_attr_destroy(&attributes);
        }
    }
};

class Processor {
public:
    explicit Processor(uint64_t seed)
        : scrambler_(seed)
    {
    }

    // Run all blocks of a launch, in the given order.
    void run(const ScrambledRange& order, size_t num_blocks, unsigned block_size, const Launch& launch)
    {
        static thread_local const SystemStack of_host_thread;  // each launch may come from another
        Processor* before = std::exchange(current_, this);
        system_stack_ = of_host_thread;
        block_size_ = block_size;
        races_.begin_launch();
        if (launch.togetherness == ALONE)
            for (size_t k = 0; k < num_blocks && !Failure::is_set(); ++k)
                run_alone((unsigned)order[k], launch);
        else
            run_together(order, num_blocks, launch);
        races_.pause();
        current_ = before;
    }

    // --- for a thread of the device ---

    static Processor& current() { return *current_; }
    static Races* races() { return current_ ? &current_->races_ : nullptr; }

    const uint64_t* exchange(const char* name, unsigned mask, uint64_t value)
    {
        const unsigned lane = threadIdx.x % 32;
        if (!(mask >> lane & 1u))
            fail_launch("lane %u calls %s with mask %08x, which does not name it", lane, name, mask);
        DeviceThread& self = *self_;
        self.brought = value;
        wait(name, mask, self.at_warp);
        return self.seen;
    }
    void wait_for_block(const char* name) { wait(name, 0, self_->at_block); }

private:
    void wait(const char* name, unsigned mask, uint32_t& number)
    {
        DeviceThread& self = *self_;
        self.waits_at = name;
        self.mask = mask;
        self.is_ready = false;
        self.fiber->yield();
        ++number;
        note_thread(self);
    }

    // Threads that never wait for another need no stack of their own.
    void run_alone(unsigned block, const Launch& launch)
    {
        blockIdx = { block, 0, 0 };
        const ScrambledRange order(block_size_, scrambler_);
        for (unsigned k = 0; k < block_size_ && !Failure::is_set(); ++k) {
            threadIdx = { (unsigned)order[k], 0, 0 };
            races_.resume({ block * block_size_ + threadIdx.x, block }, system_stack_.begin, system_stack_.num_bytes);
            launch.call();
            races_.pause();
        }
    }

    // Some blocks run at a time, and their warps in turn; where one ends the next begins. All stacks are used again.
    void run_together(const ScrambledRange& order, size_t num_blocks, const Launch& launch)
    {
        const size_t num_places = std::min<size_t>(num_blocks, launch.togetherness == BLOCKS ? 1 : std::max(1u, MOST_THREADS / block_size_));
        const unsigned num_warps = (block_size_ + 31) / 32;
        threads_.resize(num_places * block_size_);
        warps_.resize(num_places * num_warps);
        size_t next = 0, num_running = 0;
        for (; next < num_places; ++next, ++num_running)
            begin_block((unsigned)order[next], next, launch);
        while (num_running > 0 && !Failure::is_set()) {
            bool is_any = false;
            const ScrambledRange turns(warps_.size(), scrambler_);
            for (size_t k = 0; k < warps_.size() && !Failure::is_set(); ++k)
                if (Warp& warp = warps_[turns[k]]; !warp.is_over)
                    is_any = run_turn(warp, launch) || is_any;
            for (size_t place = 0; place < num_places; ++place) {
                Warp* warps = &warps_[place * num_warps];
                if (!is_block_over(warps, num_warps) && !is_any)
                    is_any = go_on(warps, num_warps);
                if (!is_block_over(warps, num_warps) || warps->is_over)
                    continue;
                for (unsigned k = 0; k < num_warps; ++k)
                    warps[k].is_over = true;
                --num_running;
                if (next < num_blocks) {
                    begin_block((unsigned)order[next++], place, launch);
                    ++num_running;
                }
            }
            if (!is_any && num_running > 0 && !release_late_lane())
                report_divergence();
        }
        // after a failure some have not ended; they are never resumed, and their stacks are used again
        for (DeviceThread& thread : threads_)
            if (thread.fiber)
                idle_.push_back(std::exchange(thread.fiber, nullptr));
    }

    void begin_block(unsigned block, size_t place, const Launch& launch)
    {
        if (launch.togetherness == BLOCKS)
            races_.begin_launch();  // the memory of the block before is used again
        const unsigned num_warps = (block_size_ + 31) / 32;
        std::fill_n(&threads_[place * block_size_], block_size_, DeviceThread());
        for (unsigned k = 0; k < num_warps; ++k) {
            Warp& warp = warps_[place * num_warps + k];
            warp = { block, 32 * k, std::min(32u, block_size_ - 32 * k), &threads_[place * block_size_ + 32 * k] };
            hold_up(warp);
        }
    }

    static bool is_block_over(const Warp* warps, unsigned num_warps)
    {
        for (unsigned k = 0; k < num_warps; ++k)
            for (unsigned j = 0; j < warps[k].count; ++j)
                if (!warps[k].lanes[j].is_ended)
                    return false;
        return true;
    }

    // If all threads of a block that have not ended wait for it, let them go on.
    static bool go_on(Warp* warps, unsigned num_warps)
    {
        for (unsigned k = 0; k < num_warps; ++k)
            for (unsigned j = 0; j < warps[k].count; ++j)
                if (const DeviceThread& thread = warps[k].lanes[j]; !thread.is_ended && (thread.is_ready || thread.mask))
                    return false;
        for (unsigned k = 0; k < num_warps; ++k)
            for (unsigned j = 0; j < warps[k].count; ++j)
                warps[k].lanes[j].is_ready = true;
        return true;
    }

    // Choose the next lane that comes late: mostly a little, now and then after all that other warps have to do.
    void hold_up(Warp& warp)
    {
        static constexpr uint64_t patience[] = { 0, 0, 0, 0, 1, 1, 3, UINT64_MAX };
        warp.late_lane = (unsigned)scrambler_.below(warp.count);
        warp.patience = patience[scrambler_.below(8)];
    }

    // Run each lane of a warp that can run until it waits or ends, but for the late one; whether any ran.
    bool run_turn(Warp& warp, const Launch& launch)
    {
        bool is_any = false, is_late_ready = false;
        const unsigned start = (unsigned)scrambler_.below(32), step = 2 * (unsigned)scrambler_.below(16) + 1;
        for (unsigned k = 0; k < 32 && !Failure::is_set(); ++k) {
            const unsigned lane = (start + k * step) % 32;
            if (lane >= warp.count)
                continue;
            DeviceThread& thread = warp.lanes[lane];
            if (thread.is_ended || !thread.is_ready)
                continue;
            if (lane == warp.late_lane && warp.patience > 0) {
                is_late_ready = true;
                continue;
            }
            is_any = true;
            run_thread(warp, lane, launch);
        }
        if (is_any)
            return true;
        if (is_late_ready && warp.patience != UINT64_MAX) {
            --warp.patience;
            return true;
        }
        return false;
    }

    // No warp goes on: let a late lane run, which all others have waited for.
    bool release_late_lane()
    {
        const ScrambledRange order(warps_.size(), scrambler_);
        for (size_t k = 0; k < warps_.size(); ++k) {
            Warp& warp = warps_[order[k]];
            if (!warp.is_over && warp.patience > 0 && warp.lanes[warp.late_lane].is_ready && !warp.lanes[warp.late_lane].is_ended) {
                warp.patience = 0;
                return true;
            }
        }
        return false;
    }

    void note_thread(const DeviceThread& thread)
    {
        const unsigned block = blockIdx.x;
        races_.resume({ block * block_size_ + threadIdx.x, block, thread.at_warp, thread.at_block }, thread.fiber->stack(), STACK_BYTES);
    }

    // Run a thread until it waits or ends.
    void run_thread(Warp& warp, unsigned lane, const Launch& launch)
    {
        DeviceThread& thread = warp.lanes[lane];
        self_ = &thread;
        blockIdx = { warp.block, 0, 0 };
        threadIdx = { warp.first + lane, 0, 0 };
        if (thread.fiber) {
            thread.fiber->resume();
        } else {
            if (idle_.empty()) {
                owned_.push_back(std::make_unique<Fiber>());
                idle_.push_back(owned_.back().get());
            }
            thread.fiber = idle_.back();
            idle_.pop_back();
            note_thread(thread);
            thread.fiber->start(&Launch::call_on_fiber, (void*)&launch);
        }
        races_.pause();
        if (!thread.fiber->is_running()) {
            thread.is_ended = true;
            idle_.push_back(std::exchange(thread.fiber, nullptr));
        } else if (thread.mask && !is_missed_by(warp, thread)) {
            meet(warp, thread.mask);
            if (warp.patience == 0)
                hold_up(warp);
        }
    }

    // A lane of the mask that has not arrived where a thread waits, as its number and one; 0 if all have.
    static unsigned is_missed_by(const Warp& warp, const DeviceThread& waiting)
    {
        for (unsigned k = 0; k < 32; ++k) {
            if (!(waiting.mask >> k & 1u))
                continue;
            if (k >= warp.count)
                return k + 1;
            const DeviceThread& other = warp.lanes[k];
            if (other.is_ended || other.is_ready || other.mask != waiting.mask || strcmp(other.waits_at, waiting.waits_at))
                return k + 1;
        }
        return 0;
    }

    // All lanes of a mask have arrived: let them go on, with what each has brought.
    static void meet(Warp& warp, unsigned mask)
    {
        for (unsigned k = 0; k < 32; ++k) {
            if (!(mask >> k & 1u))
                continue;
            DeviceThread& reader = warp.lanes[k];
            reader.is_ready = true;
            for (unsigned j = 0; j < 32; ++j)
                if (mask >> j & 1u)
                    reader.seen[j] = warp.lanes[j].brought;
        }
    }

    // No thread can go on: say what one of them waits for in vain.
    void report_divergence()
    {
        for (const Warp& warp : warps_)
            for (unsigned lane = 0; lane < warp.count && !warp.is_over; ++lane) {
                const DeviceThread& waiting = warp.lanes[lane];
                if (waiting.is_ended || !waiting.mask)
                    continue;
                const unsigned missed = is_missed_by(warp, waiting) - 1;
                const char* text = "divergence: lane %u of a warp waits at %s with mask %08x for lane %u, which ";
                if (missed >= warp.count || warp.lanes[missed].is_ended) {
                    const std::string format = std::string(text) + (missed >= warp.count ? "does not exist" : "has ended");
                    Failure::record(format.c_str(), lane, waiting.waits_at, waiting.mask, missed);
                } else {
                    const DeviceThread& other = warp.lanes[missed];
                    const std::string format = std::string(text) + "waits at %s with mask %08x";
                    Failure::record(format.c_str(), lane, waiting.waits_at, waiting.mask, missed, other.waits_at, other.mask);
                }
                return;
            }
    }

    static inline thread_local Processor* current_ __attribute__((tls_model("initial-exec"))) = nullptr;
    Scrambler scrambler_;
    Races races_;
    unsigned block_size_ = 0;
    SystemStack system_stack_;
    std::vector<DeviceThread> threads_;  // of the blocks on the processor
    std::vector<Warp> warps_;
    DeviceThread* self_ = nullptr;  // which runs
    std::vector<std::unique_ptr<Fiber>> owned_;
    std::vector<Fiber*> idle_;
};
